"""`drft hils ports`: what is listed, what answers, and one sentence for each port that does not."""

import inspect
import os
import pty
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from hils.commands.run import run
from hils.link import ports
from hils.link.link import LinkLost
from hils.link.ports import ListedPort, latency_timer, open_port
from hils.rig_sim.firmware import RigIdentity, RigProtocol

BOOT = 0x0BADCAFE


@pytest.fixture
def rig_port() -> Iterator[str]:
    """A rig behind a socket, served until the test ends."""
    protocol = RigProtocol(RigIdentity(boot_id=BOOT, rig_id=42), time.monotonic())
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.settimeout(0.01)
                while True:
                    try:
                        data = connection.recv(4096)
                    except TimeoutError:
                        data = b""
                    else:
                        if not data:
                            return
                    connection.sendall(protocol.advance(time.monotonic(), data))

        def outlive_a_reset() -> None:
            try:
                serve()
            except OSError:
                return

        thread = threading.Thread(target=outlive_a_reset, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        thread.join(15.0)


@pytest.fixture
def terminal() -> Iterator[str]:
    """A port at which nobody answers."""
    rig, host = pty.openpty()
    yield os.ttyname(host)
    os.close(rig)
    os.close(host)


def test_a_rig_that_answers_is_told_with_its_limits(drft, rig_port):
    answer = drft("hils", "ports", rig_port)
    assert answer.code == 0
    assert answer.out.splitlines() == [
        rig_port,
        "  rig 42, IDLE, boot 0badcafe: omega up to 2 rad/s, vx up to 0.3 m/s, "
        "10 um a count in z and 100 um in x",
    ]


def test_each_port_has_its_own_sentence(drft, terminal):
    answer = drft("hils", "ports", terminal, "/dev/there-is-none")
    assert answer.code == 2
    first, told, second, refused = answer.out.splitlines()
    assert (first, second) == (terminal, "/dev/there-is-none")
    assert told.startswith(f"  no rig on {terminal} answers HELLO")
    assert refused.startswith("  /dev/there-is-none cannot be opened: there is no such port")


@pytest.mark.parametrize("name", ["README.md", "docs", "/dev/null"])
def test_a_file_or_a_folder_is_no_serial_port(drft, name):
    answer = drft("hils", "ports", name)
    assert answer.code == 2
    assert answer.out.splitlines()[1] == (
        f"  {name} cannot be opened: it is no serial port; "
        "'drft hils ports' lists those that there are"
    )


def test_ports_are_asked_at_the_rate_that_a_run_takes(drft, monkeypatch):
    asked = []

    def opened(name, baud):
        asked.append(baud)
        raise LinkLost("for this test")

    monkeypatch.setattr(ports, "open_port", opened)
    drft("hils", "ports", "/dev/ttyX9")
    assert asked == [inspect.signature(run).parameters["baud"].default]


def test_a_port_in_use_is_left_alone(drft, terminal):
    held = open_port(terminal, 115_200)
    assert "another program uses it" in drft("hils", "ports", terminal).out
    held.close()


def test_ports_are_listed_with_what_is_known_of_them(drft, monkeypatch):
    monkeypatch.setattr(ports, "list_ports", lambda: [ListedPort("/dev/ttyX9", "USB, FTDI")])
    monkeypatch.setattr(ports, "latency_timer", lambda name: 16)
    answer = drft("hils", "ports", "--no-hello")
    assert answer.out.splitlines() == [
        "/dev/ttyX9: USB, FTDI",
        "  its adapter waits 16 ms with what it received; see --help",
    ]


def test_no_port_at_all_is_said(drft, monkeypatch):
    monkeypatch.setattr(ports, "list_ports", list)
    assert drft("hils", "ports").out == "there is no serial port\n"


def test_a_baud_rate_that_cannot_be_is_refused(drft):
    assert drft("hils", "ports", "--baud", 0).refusal.startswith("baud rate is 0")
    assert drft("hils", "ports", "--patience", "nan").refusal.startswith("patience is nan")


def test_help_names_the_latency_timer(drft):
    assert "latency_timer=1" in drft("hils", "ports", "--help").out


def test_a_terminal_has_no_latency_timer(terminal):
    assert latency_timer(terminal) is None
