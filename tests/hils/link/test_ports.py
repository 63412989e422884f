"""Ports: bytes whole, refusals in a sentence, and no call that waits for a peer.

Real time passes here. Deadlines are on what comes of it and generous (`PATIENCE`), for the machine
may be busy; nothing is asserted to be quick but what would otherwise never return.
"""

import os
import socket
import sys
import termios
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from drftjax.common.errors import InputError
from hils.link import ports
from hils.link.link import LinkLost
from hils.link.messages import Arm, Drop, Frame, Measurement, RigState, encode
from hils.link.port_link import PortLink
from hils.link.ports import DEFAULT_PORT, SerialPort, SocketPort, UrlPort, list_ports, open_port
from tests.helpers.link_endpoints import (
    BAUD,
    PATIENCE,
    SESSION,
    STILL,
    Ends,
    eventually,
    lost,
    thread_of,
)


@pytest.fixture
def ends():
    ends = Ends()
    yield ends
    ends.hang_up()


def is_closed_to_others(descriptor: int) -> bool:
    """True where the system lets no other program open this terminal."""
    import fcntl

    get_exclusive = 0x80045440  # TIOCGEXCL, Linux
    return int.from_bytes(fcntl.ioctl(descriptor, get_exclusive, bytes(4)), sys.byteorder) != 0


@pytest.mark.skipif(sys.platform != "linux", reason="TIOCGEXCL is Linux's")
def test_a_device_is_closed_to_programs_that_ask_for_no_lock(ends, monkeypatch):
    monkeypatch.setattr(ports, "_is_pseudo_terminal", lambda descriptor: False)
    for exclusive in (False, True):
        other = os.open(ends.name, os.O_RDWR | os.O_NOCTTY)
        port = open_port(ends.name, BAUD, exclusive=exclusive)
        assert is_closed_to_others(other) is exclusive
        port.close()
        os.close(other)


@pytest.mark.skipif(sys.platform != "linux", reason="TIOCGEXCL is Linux's")
def test_a_pseudo_terminal_can_be_opened_again_after_a_kill(ends):
    port = open_port(ends.name, BAUD)
    other = os.open(ends.name, os.O_RDWR | os.O_NOCTTY)
    assert not is_closed_to_others(other)
    os.close(other)
    port.close()


def test_every_byte_passes_a_terminal_unchanged(ends):
    port = open_port(ends.name, BAUD)
    assert isinstance(port, SerialPort)
    every = bytes(range(256))
    assert port.read(10) == b""
    os.write(ends.rig, every)
    data = b""

    def all_came() -> bool:
        nonlocal data
        port.wait(True, False, time.monotonic() + 0.1)
        data += port.read(4096)
        return len(data) >= 256

    eventually(all_came)
    assert data == every
    assert port.write(every) == 256
    assert ends.received(256) == every
    port.close()


class SlowDriver:
    """A device whose driver says how much it has not sent yet."""

    out_waiting = 0

    def __init__(self, descriptor: int):
        self._descriptor = descriptor

    def fileno(self) -> int:
        return self._descriptor

    def reset_output_buffer(self) -> None:
        pass

    def close(self) -> None:
        os.close(self._descriptor)


def test_a_driver_is_not_filled_with_commands_that_grow_old(ends):
    device = SlowDriver(os.open(ends.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
    port = SerialPort(device, ends.name)
    device.out_waiting = DEFAULT_PORT.backlog
    assert port.write(b"old") == 0
    port.wait(True, True, time.monotonic() + 60.0)  # looks again soon, though there is room
    device.out_waiting = DEFAULT_PORT.backlog - 3  # the whole frame must find room
    assert port.write(b"new") == 3
    assert ends.received(3) == b"new"
    port.close()


def test_a_terminal_whose_other_end_goes_is_lost(ends):
    link = PortLink(open_port(ends.name, BAUD))
    threading.Timer(0.05, ends.hang_up).start()
    assert f"{ends.name} is lost" in lost(link)
    link.close()


def test_a_peer_that_stops_reading_does_not_hold_anyone(ends):
    link = PortLink(open_port(ends.name, BAUD))
    link.begin(SESSION)

    def flood() -> None:
        while True:
            link.send(STILL)
            time.sleep(1e-5)

    with pytest.raises(LinkLost, match="has taken nothing"):
        flood()
    assert link.quality().replaced > 0
    link.close()
    assert not thread_of(link).is_alive()


@pytest.mark.parametrize("way", ["", "spy://", "alt://"])
def test_a_port_in_use_is_refused(ends, way):
    port = open_port(ends.name, BAUD)
    with pytest.raises(LinkLost, match="another program uses it"):
        open_port(way + ends.name, BAUD)
    port.close()
    open_port(ends.name, BAUD).close()


def test_a_socket_whose_other_end_goes_is_lost():
    host, rig = socket.socketpair()
    link = PortLink(SocketPort(host, "the pair"))
    rig.close()
    assert "the pair is lost: it hung up" in lost(link)
    link.close()


def test_a_socket_url_is_a_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        link = PortLink(open_port(f"socket://127.0.0.1:{number}", BAUD))
        rig, _ = server.accept()
        link.begin(SESSION)
        rig.sendall(encode(Frame(Measurement(0, 5, 6, 0.0, RigState.IDLE, 0), SESSION, 1, 0)))
        assert link.wait(time.monotonic() + PATIENCE)
        assert link.newest().frame.message.z == 5
        link.close()
        rig.close()
    with pytest.raises(LinkLost, match="Connection refused"):
        open_port(f"socket://127.0.0.1:{number}", BAUD)


def test_a_loop_gives_the_host_back_its_own_words():
    port = open_port("loop://", BAUD)
    assert isinstance(port, UrlPort)
    link = PortLink(port)
    link.begin(SESSION)
    link.send(Arm())
    eventually(lambda: link.quality().drops == {Drop.DIRECTION: 1})
    link.close()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("/dev/there-is-none", "there is no such port"),
        ("/dev/null", "cannot be opened"),
        ("nonsense://x", "cannot be opened"),
        ("socket://nowhere", "must be socket://host:port"),
        ("socket://h:99999999", "must be socket://host:port"),
        ("hwgrep://no such adapter at all", "cannot be opened"),
        ("hwgrep://(", "cannot be opened: .*unterminated"),
        ("loop://?foo=1", "cannot be opened"),
        ("socket://a..b:80", "cannot be opened"),
        ("", "cannot be opened"),
    ],
)
def test_a_port_that_cannot_be_is_refused_in_a_sentence(name, said):
    with pytest.raises(InputError, match=said) as error:
        open_port(name, BAUD)
    assert "\n" not in str(error.value)


def descriptors() -> set[Path]:
    """What this process holds open."""
    return {each for each in Path("/proc/self/fd").iterdir() if each.is_symlink()}


# pyserial's own set-up ends with the first, what is set after it begins with the second.
@pytest.mark.parametrize("failing", ["tcsetattr", "tcgetattr"])
def test_a_terminal_that_cannot_be_set_up_is_one_sentence(ends, monkeypatch, failing):
    def refuse(*given):
        raise termios.error(5, "Input/output error")

    before = descriptors()
    monkeypatch.setattr(termios, failing, refuse)
    with pytest.raises(LinkLost, match="Input/output error"):
        open_port(ends.name, BAUD)
    assert descriptors() == before


def test_a_device_that_is_no_terminal_leaves_nothing_open_but_itself():
    device = SlowDriver(os.open(os.devnull, os.O_RDWR))
    before = descriptors()
    with pytest.raises(LinkLost, match="Inappropriate ioctl"):
        SerialPort(device, "no terminal")
    assert descriptors() == before
    device.close()


def test_a_socket_that_cannot_be_set_up_leaves_nothing_open(monkeypatch):
    class Stubborn(socket.socket):
        def setsockopt(self, *given):
            raise OSError(92, "Protocol not available")

    monkeypatch.setattr(
        "hils.link.ports._connected", lambda url, time: made.append(Stubborn()) or made[-1]
    )
    made: list[socket.socket] = []
    before = descriptors()
    with pytest.raises(LinkLost, match="Protocol not available"):
        open_port("socket://h:1", BAUD)
    assert made[0].fileno() == -1
    assert descriptors() == before


@pytest.mark.parametrize("baud", [0, -1, 10**9])
def test_a_baud_rate_that_cannot_be_is_refused(baud):
    with pytest.raises(InputError, match="baud rate is"):
        open_port("loop://", baud)


def test_a_port_woken_before_it_waits_does_not_wait():
    host, rig = socket.socketpair()
    for port in (SocketPort(host), open_port("loop://", BAUD)):
        start = time.monotonic()
        port.wake()
        port.wait(True, False, start + 60.0)
        assert time.monotonic() - start < PATIENCE
        port.close()
        port.wake()
    rig.close()


def test_ports_are_listed_by_name_with_what_is_known_of_them(monkeypatch):
    told = [("/dev/ttyUSB1", "UART", "FTDI"), ("/dev/ttyS0", "n/a", None), ("/dev/ttyUSB0", "", "")]
    found = [
        SimpleNamespace(device=device, description=description, manufacturer=manufacturer)
        for device, description, manufacturer in told
    ]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    nothing = "nothing known of it"
    assert list_ports() == [
        ("/dev/ttyS0", nothing),
        ("/dev/ttyUSB0", nothing),
        ("/dev/ttyUSB1", "UART, FTDI"),
    ]
