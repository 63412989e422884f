"""Ports and the thread that serves a link: bytes whole, no call that waits, threads that end.

Real time passes here. Deadlines are on what comes of it and generous (`PATIENCE`), for the machine
may be busy; nothing is asserted to be quick but what would otherwise never return.
"""

import os
import pty
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest

from drftjax.errors import InputError
from hils.clock import MonotonicClock
from hils.link import LinkLost
from hils.port import BACKLOG, AbstractPort, SerialPort, SocketPort, UrlPort, open_port, ports
from hils.port_link import PortLink, first_number
from hils.receiver import Receiver
from hils.rig_protocol import RigIdentity, RigProtocol
from hils.session import Session
from hils.wire import (
    FROM_HOST,
    FROM_RIG,
    Arm,
    Bye,
    Drive,
    Drop,
    EmergencyStop,
    Frame,
    Hello,
    Measurement,
    RigState,
    StateReport,
    encode,
    newer,
)

PATIENCE = 15.0
BAUD = 115_200
SESSION = 21
STILL = Drive(0.0, 0.0, False, 5000)
SLOW_TICK = Hello(
    1_000_000, 5000
)  # a watchdog of 5 s, which a busy machine does not meet by chance


def eventually(true: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(1e-3)


def lost(link: PortLink) -> str:
    """What the link says once it is lost."""

    def listen() -> None:
        while link.wait(time.monotonic() + PATIENCE):
            pass

    with pytest.raises(LinkLost) as error:
        listen()
    return str(error.value)


def acknowledged(link: PortLink) -> int | None:
    """The command that the newest measurement answers."""
    newest = link.newest()
    return newest and newest.frame.message.ack_seq


def thread_of(link: PortLink) -> threading.Thread:
    return vars(link)["_thread"]


class Ends:
    """A pseudo-terminal: the rig's end as a descriptor, and the name of the host's."""

    def __init__(self):
        self.rig, host = pty.openpty()
        self.name = os.ttyname(host)
        os.close(host)
        os.set_blocking(self.rig, False)

    def hang_up(self) -> None:
        rig, self.rig = self.rig, -1
        if rig >= 0:
            os.close(rig)

    def received(self, count: int) -> bytes:
        data = b""

        def enough() -> bool:
            nonlocal data
            with suppress(OSError):
                data += os.read(self.rig, 4096)
            return len(data) >= count

        eventually(enough)
        return data


@pytest.fixture
def ends() -> Iterator[Ends]:
    ends = Ends()
    yield ends
    ends.hang_up()


class ServedRig:
    """A rig at one end of a socket pair, in a thread."""

    def __init__(self):
        self.host, self._socket = socket.socketpair()
        self._socket.settimeout(1e-3)
        self.protocol = RigProtocol(RigIdentity(boot_id=1), time.monotonic())
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._end.is_set():
            try:
                data = self._socket.recv(4096)
            except TimeoutError:
                data = b""
            except OSError:
                return
            out = self.protocol.advance(time.monotonic(), data)
            try:
                self._socket.sendall(out)
            except OSError:
                return

    def end(self) -> None:
        self._end.set()
        self._thread.join(PATIENCE)
        self._socket.close()


@pytest.fixture
def rig() -> Iterator[ServedRig]:
    rig = ServedRig()
    yield rig
    rig.end()


def is_armed(session: Session) -> bool:
    """Whether the rig could be armed; a busy machine may let its quarter of a second pass."""
    try:
        session.arm(STILL)
    except InputError:
        return False
    return True


class ScriptedPort(AbstractPort):
    """Takes and gives as it is told."""

    def __init__(self, room: int = 1 << 20):
        self.room, self.taken = room, b""
        self.broken: Exception | None = None
        self.closed = False
        self._woken = threading.Event()

    @property
    def name(self) -> str:
        return "the scripted port"

    def read(self, limit: int) -> bytes:
        if self.broken is not None:
            raise self.broken
        return b""

    def write(self, data: bytes) -> int:
        self.taken += data[: self.room]
        return min(self.room, len(data))

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        if writable and self.room:
            return
        self._woken.wait(min(0.01, max(0.0, deadline - time.monotonic())))
        self._woken.clear()

    def wake(self) -> None:
        self._woken.set()

    def close(self) -> None:
        self.closed = True


def messages(data: bytes) -> list:
    receiver = Receiver(FROM_HOST)
    receiver.expect(SESSION)
    found = [frame.message for frame in receiver.feed(data)]
    assert receiver.drops == {}
    return found


# The thread --------------------------------------------------------------------------------------


def test_a_whole_session_over_a_socket(rig):
    clock = MonotonicClock()
    link = PortLink(SocketPort(rig.host), clock)
    session = Session(link, clock)
    assert session.connect(SLOW_TICK, PATIENCE).boot_id == 1
    eventually(lambda: is_armed(session))
    for omega in (0.25, 0.5, 0.75):
        seq = link.send(Drive(omega, 0.0, False, 5000))
        eventually(lambda seq=seq: acknowledged(link) == seq)
        session.check()
    assert rig.protocol.state is RigState.RUNNING
    session.stop()
    session.bye()
    link.close()
    assert rig.protocol.state is RigState.IDLE
    assert not thread_of(link).is_alive()


def test_what_was_handed_over_is_sent_before_the_link_closes():
    port = ScriptedPort(room=1)  # a byte at a time
    link = PortLink(port)
    link.begin(SESSION)
    link.send(Arm())
    link.send(STILL)
    link.send(Bye())
    link.close()
    assert messages(port.taken) == [Arm(), STILL, Bye()]
    assert port.closed


def test_a_line_that_takes_nothing_keeps_only_the_newest_command_and_is_lost():
    port = ScriptedPort(room=0)
    link = PortLink(port)
    link.begin(SESSION)
    link.send(Arm())
    for omega in range(100):
        link.send(Drive(omega / 128, 0.0, False, 50))
    assert link.quality().replaced >= 98
    assert "has taken nothing" in lost(link)
    eventually(lambda: not thread_of(link).is_alive())
    link.close()


def test_an_emergency_stop_is_next_once_the_line_takes_again():
    port = ScriptedPort(room=0)
    link = PortLink(port)
    link.begin(SESSION)
    link.send(STILL)
    eventually(lambda: vars(link)["_rest"])  # on its way already, so it goes to its end
    for message in (Arm(), STILL, EmergencyStop(2)):
        link.send(message)
    port.room = 1000
    eventually(lambda: len(port.taken) > 31)
    assert messages(port.taken) == [STILL, EmergencyStop(2)]
    link.close()


@pytest.mark.parametrize(
    "error", [LinkLost("it is out"), OSError(5, "Input/output error"), RuntimeError("a slip")]
)
def test_whatever_breaks_the_thread_is_told_to_who_waits(error):
    port = ScriptedPort()
    link = PortLink(port)
    link.begin(SESSION)
    threading.Timer(0.05, lambda: setattr(port, "broken", error)).start()
    assert str(error) in lost(link) or "Input/output error" in lost(link)
    for call in (link.newest, link.reports, lambda: link.send(STILL), lambda: link.begin(4)):
        with pytest.raises(LinkLost):
            call()
    link.quality()
    eventually(lambda: not thread_of(link).is_alive())
    link.close()
    assert port.closed


def test_closing_twice_and_using_afterwards():
    link = PortLink(ScriptedPort())
    link.close()
    link.close()
    with pytest.raises(LinkLost, match="was let go"):
        link.wait(time.monotonic() + PATIENCE)


def test_waiting_ends_at_its_deadline():
    link = PortLink(ScriptedPort())
    start = time.monotonic()
    assert not link.wait(start + 0.05)
    assert time.monotonic() >= start + 0.05
    assert not link.wait(start)
    link.close()


def test_the_thread_says_that_it_has_started():
    names = []
    link = PortLink(ScriptedPort(), started=lambda: names.append(threading.current_thread().name))
    link.close()
    assert names == ["link the scripted port"]


@pytest.mark.parametrize("start", [0.0, 1.7e9, (1 << 31) / 2000 - 0.001, 4e9])
def test_a_restarted_host_is_newer_for_a_rig_that_counts_on_and_for_one_that_starts_at_zero(start):
    first = first_number(start)
    assert newer(first, 0)
    assert 0 < first < 1 << 31
    if first < 1 << 30:
        sent_at_1_khz = 1000 * 100
        assert newer(first_number(start + 101.0), first + sent_at_1_khz)


def test_arrivals_are_timed_by_the_links_clock(rig):
    clock = MonotonicClock()
    link = PortLink(SocketPort(rig.host), clock)
    before = clock.now()
    Session(link, clock).connect(SLOW_TICK, PATIENCE)
    eventually(lambda: link.newest() is not None)
    assert before <= link.newest().time <= clock.now()
    link.close()


def test_who_waits_hears_that_the_link_is_closed():
    link = PortLink(ScriptedPort())
    heard = []
    waiting = threading.Thread(target=lambda: heard.append(lost(link)))
    waiting.start()
    link.close()
    waiting.join(PATIENCE)
    assert heard == ["the scripted port was let go"]


def test_a_program_that_forgets_its_link_ends_all_the_same():
    program = (
        "import socket; from hils.port import SocketPort; from hils.port_link import PortLink\n"
        "ends = socket.socketpair(); link = PortLink(SocketPort(ends[0])); link.begin(5)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60.0)


def test_many_hands_on_one_link_lose_and_mix_nothing(rig):
    link = PortLink(SocketPort(rig.host))
    Session(link, MonotonicClock()).connect(SLOW_TICK, PATIENCE)
    greetings = link.quality().sent

    def work() -> None:
        for _ in range(300):
            link.send(STILL)
            link.wait(time.monotonic() + 1e-3)
            link.newest()
            link.quality()

    hands = [threading.Thread(target=work) for _ in range(4)]
    for hand in hands:
        hand.start()
    for hand in hands:
        hand.join(PATIENCE)
    last = link.send(STILL)
    eventually(lambda: acknowledged(link) == last)
    quality = link.quality()
    assert quality.drops == {}
    assert rig.protocol.drops == {}
    assert quality.sent == greetings + 1201 - quality.replaced
    link.close()


# Ports -------------------------------------------------------------------------------------------


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
    device.out_waiting = BACKLOG
    assert port.write(b"old") == 0
    port.wait(True, True, time.monotonic() + 60.0)  # looks again soon, though there is room
    device.out_waiting = BACKLOG - 1
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


def test_a_port_in_use_is_refused(ends):
    port = open_port(ends.name, BAUD)
    with pytest.raises(LinkLost, match="another program uses it"):
        open_port(ends.name, BAUD)
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
        ("", "cannot be opened"),
    ],
)
def test_a_port_that_cannot_be_is_refused_in_a_sentence(name, said):
    with pytest.raises(InputError, match=said) as error:
        open_port(name, BAUD)
    assert "\n" not in str(error.value)


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


def test_ports_are_listed_by_name():
    assert [each.name for each in ports()] == sorted(each.name for each in ports())


def test_rig_words_reach_the_host_in_order(rig):
    link = PortLink(SocketPort(rig.host))
    link.begin(SESSION)
    link.send(SLOW_TICK)
    link.send(Arm())
    heard = []

    def all_heard() -> bool:
        link.wait(time.monotonic() + 0.1)
        heard.extend(each.frame.message for each in link.reports())
        return len(heard) >= 2

    eventually(all_heard)
    assert isinstance(heard[1], StateReport)
    assert heard[1].state is RigState.ARMED
    assert all(isinstance(each, FROM_RIG) for each in heard)
    link.close()
