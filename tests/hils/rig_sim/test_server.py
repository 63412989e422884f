"""The virtual rig as a process of its own, at a pseudo-terminal or a socket, in real time.

Deadlines are on outcomes and generous: the machine may be busy.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hils.link.framing import Receiver
from hils.link.messages import FROM_RIG, Bye, Frame, Hello, HelloAck, Measurement, RigState, encode
from hils.rig_sim.endpoints import PtyEnd
from tests.helpers.drft_command import Drft
from tests.helpers.rig_server import HOST, PATIENCE, Rig, open_raw

TICK, WATCHDOG = 0.01, 0.05
# What a busy machine may add before the test is told [s]; an idle one adds some milliseconds.
MARGIN = 1.0


@pytest.fixture
def started(tmp_path):
    rigs: list[Rig] = []

    def start(*arguments: object) -> Rig:
        rigs.append(Rig(tmp_path, *arguments))
        return rigs[-1]

    yield start
    for rig in rigs:
        rig.process.kill()
        rig.process.wait()


@pytest.fixture
def drft(monkeypatch, capsys) -> Drft:
    monkeypatch.setenv("NPROC", "1")  # which the command sets, and which ends with the test
    return Drft(monkeypatch, capsys)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--baud", 3], ["--baud is 3", "300"]),
        (["--latency", -1], ["--latency is -1 ms"]),
        (["--seed", -1], ["--seed is -1"]),
        (["--socket", 0, "--link", "rig"], ["--link", "--socket"]),
        (["--socket", 99999], ["port 99999", "must lie between 0 and 65535"]),
        (["--seconds", 0], ["--seconds is 0 s, must be above 0"]),
        (["--seconds", -1], ["--seconds is -1 s, must be above 0"]),
        (["--link", "."], [".", "is there already"]),
        (["--link", "no/such/folder/rig"], ["no/such/folder/rig"]),
        (["--setup", "no.toml"], ["no.toml: there is no such file"]),
        (["--faults", "no.toml"], ["no.toml: there is no such file"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(drft, arguments, words):
    refusal = drft("hils", "rig", *arguments).refusal
    assert all(word in refusal for word in words), refusal


def heard(port: int, receiver: Receiver, wanted: type) -> Frame:
    """The first message of this kind that comes."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if select.select([port], [], [], 0.1)[0]:
            for frame in receiver.feed(os.read(port, 4096)):
                if isinstance(frame.message, wanted):
                    return frame
    raise AssertionError(f"no {wanted.__name__} came")


def greet(port: int, session: int = 5) -> Receiver:
    receiver = Receiver(FROM_RIG)
    receiver.expect(session)
    os.write(port, encode(Frame(Hello(10_000, 50), session, 1, 0)))
    return receiver


def test_rig_answers_at_a_pseudo_terminal_and_leaves_no_link_behind(started, tmp_path):
    link = tmp_path / "rig"
    rig = started("--link", link)
    assert rig.name == str(link)
    port = open_raw(rig.name)
    receiver = greet(port)
    assert isinstance(heard(port, receiver, HelloAck).message, HelloAck)
    measured = heard(port, receiver, Measurement).message
    assert (measured.state, abs(measured.z) < 20) == (RigState.IDLE, True)
    os.write(port, encode(Frame(Bye(), 5, 2, 0)))
    os.close(port)
    port = open_raw(rig.name)  # a host may come again
    heard(port, greet(port, 6), HelloAck)
    assert rig.end() == 0
    assert not link.is_symlink()


def test_link_to_a_port_in_use_is_refused_and_left_to_its_rig(drft, tmp_path):
    link = tmp_path / "rig"
    first = PtyEnd(link)
    leads_to = link.readlink()
    said = drft("hils", "rig", "--link", link, "--seconds", 0.1).refusal
    assert said.startswith(f"{link}: leads to {leads_to}, which is in use, perhaps by another rig")
    assert link.readlink() == leads_to
    first.unplug()
    assert not link.is_symlink()


def test_link_that_another_has_taken_meanwhile_is_not_removed(tmp_path):
    link = tmp_path / "rig"
    first = PtyEnd(link)
    link.unlink()
    other = PtyEnd(link)
    first.unplug()
    assert link.is_char_device()
    other.unplug()
    assert not link.is_symlink()


def test_link_that_a_killed_rig_has_left_is_replaced(tmp_path):
    link = tmp_path / "rig"
    link.symlink_to("/dev/pts/there-is-none")
    end = PtyEnd(link)
    assert link.is_char_device()
    end.unplug()


def test_rig_answers_at_a_socket_and_hosts_may_come_and_go(started):
    rig = started("--socket", 0)
    number = int(rig.name.removeprefix("socket://127.0.0.1:"))
    for session in (3, 4):
        with socket.create_connection(("127.0.0.1", number), PATIENCE) as line:
            heard(line.fileno(), greet(line.fileno(), session), HelloAck)
    assert rig.end() == 0


def test_rig_is_safe_within_watchdog_and_a_tick_after_kill_9_of_the_host(started):
    rig = started()
    host = subprocess.Popen([sys.executable, "-c", HOST, rig.name])
    try:
        rig.says("RUNNING")
        time.sleep(0.3)
        host.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        told, silence = rig.says(r"SAFE \(watchdog, ([\d.]+) ms")
    finally:
        host.kill()
        host.wait()
    assert float(silence[1]) * 1e-3 <= WATCHDOG + TICK  # by the rig's own clock
    assert told - killed <= WATCHDOG + TICK + MARGIN


def test_pulled_plug_hangs_up_and_comes_back(started, tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text(
        '[[fault]]\nwhat = {kind = "disconnect"}\n'
        'when = {after = "hello", start = 0.5, duration = 0.5}\n'
    )
    rig = started("--faults", faults, "--link", tmp_path / "rig")
    port = open_raw(rig.name)
    heard(port, greet(port), HelloAck)
    deadline = time.monotonic() + PATIENCE
    with pytest.raises(OSError):  # noqa: PT012
        while time.monotonic() < deadline:
            if not os.read(port, 4096):
                raise OSError("hung up")
    os.close(port)
    while not Path(rig.name).exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    port = open_raw(rig.name)
    heard(port, greet(port, 6), HelloAck)
