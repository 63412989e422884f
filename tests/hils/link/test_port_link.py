"""The thread that serves a link: bytes whole, no call that waits, threads that end.

Real time passes here. Deadlines are on what comes of it and generous (`PATIENCE`), for the machine
may be busy; nothing is asserted to be quick but what would otherwise never return.
"""

import subprocess
import sys
import threading
import time

import pytest

from hils.clock import MonotonicClock
from hils.link.link import LinkLost
from hils.link.messages import (
    FROM_RIG,
    Arm,
    Bye,
    Drive,
    EmergencyStop,
    RigState,
    StateReport,
    is_newer,
)
from hils.link.port_link import PortLink, first_number
from hils.link.ports import SocketPort
from hils.procedure.session import Session
from tests.helpers.link_endpoints import (
    PATIENCE,
    SESSION,
    SLOW_TICK,
    STILL,
    Ends,
    ScriptedPort,
    ServedRig,
    acknowledged,
    eventually,
    is_armed,
    lost,
    messages,
    thread_of,
)

# The thread --------------------------------------------------------------------------------------


@pytest.fixture
def ends():
    ends = Ends()
    yield ends
    ends.hang_up()


@pytest.fixture
def rig():
    rig = ServedRig()
    yield rig
    rig.end()


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
    assert is_newer(first, 0)
    assert 0 < first < 1 << 31
    if first < 1 << 30:
        sent_at_1_khz = 1000 * 100
        assert is_newer(first_number(start + 101.0), first + sent_at_1_khz)


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
        "import socket\nfrom hils.link.ports import SocketPort\n"
        "from hils.link.port_link import PortLink\n"
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
