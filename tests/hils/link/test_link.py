"""Links: what waits to be sent, what came, and that both ends of a lost line hear of it."""

import math

import pytest

from drftjax.common.errors import InputError
from hils.clock import MonotonicClock, VirtualClock
from hils.link.framing import Receiver
from hils.link.link import InProcessLink, LinkLost
from hils.link.messages import (
    FROM_HOST,
    Arm,
    Drive,
    EmergencyStop,
    Hello,
    HelloAck,
    Measurement,
    RigState,
    Stop,
)
from hils.link.send_queue import SendQueue
from hils.rig_sim.firmware import RigIdentity, RigProtocol

SESSION = 9
HELLO = Hello(10_000, 50)
# Virtual time is exact, but for its sums.
SUMS = 1e-12


def drive(omega: float) -> Drive:
    return Drive(omega, 0.0, False, 50)


# What waits to be sent ---------------------------------------------------------------------------


def taken(outbox: SendQueue) -> list:
    receiver = Receiver(FROM_HOST)
    receiver.expect(SESSION)
    data = b"".join(iter(outbox.take, b""))
    frames = receiver.feed(data)
    assert receiver.drops == {}
    return [frame.message for frame in frames]


@pytest.fixture
def outbox() -> SendQueue:
    outbox = SendQueue()
    outbox.begin(SESSION)
    return outbox


def test_of_commands_the_newest_wins(outbox):
    for omega in (0.25, 0.5, 1.0):
        outbox.put(drive(omega), 0.0)
    assert outbox.replaced == 2
    assert taken(outbox) == [drive(1.0)]
    assert outbox.sent == 1


def test_all_else_goes_in_order(outbox):
    for message in (HELLO, Arm(), drive(0.5), Stop(), drive(0.0)):
        outbox.put(message, 0.0)
    assert taken(outbox) == [HELLO, Arm(), Stop(), drive(0.0)]


def test_an_emergency_stop_overtakes_all_that_waits(outbox):
    for message in (HELLO, Arm(), drive(0.5), EmergencyStop(3), drive(0.25)):
        outbox.put(message, 0.0)
    assert taken(outbox) == [EmergencyStop(3), drive(0.25)]


def test_sequence_numbers_count_on_over_sessions_and_wrap():
    outbox = SendQueue(first=2**32 - 1)
    outbox.begin(1)
    assert outbox.put(Arm(), 0.0).seq == 2**32 - 1
    outbox.begin(2)
    assert outbox.put(Arm(), 0.0).seq == 0
    assert len(outbox) == 1


@pytest.mark.parametrize("omega", [math.nan, math.inf, 1e39])
def test_a_command_that_is_no_number_is_refused_and_leaves_the_last(outbox, omega):
    outbox.put(drive(0.5), 0.0)
    with pytest.raises(InputError):
        outbox.put(drive(omega), 0.0)
    assert taken(outbox) == [drive(0.5)]


@pytest.mark.parametrize("session", [0, -1, 65_536])
def test_a_session_number_that_cannot_be_is_refused(outbox, session):
    with pytest.raises(InputError, match="must lie between 1 and 65535"):
        outbox.begin(session)


# Virtual time ------------------------------------------------------------------------------------


class Diary:
    """Notes the times it is told."""

    def __init__(self):
        self.times = []

    def advance(self, now: float) -> None:
        self.times.append(now)


def test_virtual_time_passes_in_grains_and_ends_where_it_is_asked():
    clock, diary = VirtualClock(start=5.0, grain=0.01), Diary()
    clock.attach(diary)
    clock.sleep_until(5.025)
    assert diary.times == pytest.approx([5.01, 5.02, 5.025])
    clock.sleep_until(4.0)
    assert clock.now() == 5.025
    assert len(diary.times) == 3


def test_the_monotonic_clock_sleeps_to_its_deadline_and_not_past_one_that_is_over():
    clock = MonotonicClock()
    deadline = clock.now() + 0.02
    clock.sleep_until(deadline)
    assert clock.now() >= deadline
    clock.sleep_until(deadline - 100.0)


# The soft link -----------------------------------------------------------------------------------


class BrokenRig:
    """Answers nothing, and breaks the line at one second."""

    def advance(self, now: float, data: bytes) -> bytes:
        if now >= 1.0:
            raise LinkLost("the cable is out")
        return b""


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def link(clock: VirtualClock) -> InProcessLink:
    link = InProcessLink(RigProtocol(RigIdentity(boot_id=3)), clock)
    link.begin(SESSION)
    return link


def test_a_soft_rig_answers_at_once(link, clock):
    link.send(HELLO)
    (arrival,) = link.reports()
    assert isinstance(arrival.frame.message, HelloAck)
    assert arrival.time == clock.now() == 0.0
    assert link.reports() == []


def test_the_newest_measurement_stays_until_there_is_a_newer(link, clock):
    assert link.newest() is None
    link.send(HELLO)
    seq = link.send(drive(0.0))
    first = link.newest()
    assert first.frame.message == Measurement(seq, 0, 0, 0.0, RigState.IDLE, 0)
    assert link.newest() is first
    clock.sleep_until(0.1)
    assert link.newest().time == pytest.approx(0.1, abs=SUMS)


def test_waiting_ends_with_an_arrival_or_at_the_deadline(link, clock):
    assert not link.wait(0.3)
    assert clock.now() == 0.3
    link.send(HELLO)
    assert link.wait(0.5)
    assert clock.now() == 0.3
    link.reports()
    assert link.wait(0.5)  # the first measurement that comes by itself
    assert clock.now() == pytest.approx(0.32, abs=SUMS)
    assert not link.wait(0.0)


def test_who_takes_only_measurements_is_not_kept_awake_by_reports(link, clock):
    link.send(HELLO)
    assert link.wait(1.0)
    assert link.wait(1.0)
    # Not before the measurement after the one of the greeting, 20 ms on.
    assert clock.now() == pytest.approx(0.02, abs=SUMS)


def test_a_new_session_forgets_the_old_ones_words(link):
    link.send(HELLO)
    link.send(drive(0.0))
    link.begin(SESSION + 1)
    assert link.newest() is None
    assert link.reports() == []
    assert not link.wait(0.0)


def test_quality_counts_both_ways(link, clock):
    link.send(HELLO)
    link.send(drive(0.0))
    clock.sleep_until(0.5)
    quality = link.quality()
    assert (quality.sent, quality.bytes_sent) == (2, 62)
    assert quality.received == 2 + 24
    assert quality.bytes_received == 51 + 39 * 25
    assert (quality.drops, quality.dropped, quality.time) == ({}, 0, 0.5)


def test_a_lost_line_is_told_by_every_call_and_never_by_the_clock():
    clock = VirtualClock()
    link = InProcessLink(BrokenRig(), clock)
    link.begin(SESSION)
    clock.sleep_until(2.0)
    for call in (
        lambda: link.send(Arm()),
        link.newest,
        link.reports,
        lambda: link.wait(3.0),
        lambda: link.begin(4),
    ):
        with pytest.raises(LinkLost, match="the cable is out"):
            call()
    link.quality()
    link.close()


def test_a_link_that_was_let_go_is_lost(link):
    link.close()
    with pytest.raises(LinkLost, match="was let go"):
        link.send(Arm())
    link.close()
