"""The host's side of a session, in virtual time, with rigs that read the page in their own ways."""

import math
import struct

import pytest

from drftjax.common.errors import InputError
from hils.link.link import MOST_REPORTS, LinkLost
from hils.link.messages import (
    REASON_MEANINGS,
    VIRTUAL_RIG,
    Arm,
    Drive,
    EmergencyStop,
    Frame,
    Hello,
    Reason,
    RigState,
    StateReport,
    encode,
    wire_bytes,
)
from hils.procedure.session import (
    DEFAULT_SESSION,
    RigStopped,
    Session,
    SessionSettings,
    draw_session_number,
)
from hils.rig_sim.firmware import RigIdentity, RigProtocol
from tests.helpers.protocol_variants import (
    HELLO,
    HOLD,
    ROUNDING,
    Buttons,
    OtherRig,
    Silent,
    Table,
    ours,
)

# Firmware of others ------------------------------------------------------------------------------

READINGS = {
    "as we would": {},
    "delimiters behind only": {"leading_delimiter": False},
    "the watchdog counts before ARM too": {"watchdog_counts_in_idle": True},
    "sequence numbers restart at HELLO": {"restarts_count_at_hello": True},
    "RUNNING from ARM on": {"runs_at_arm": True},
    "ARM is answered by measurements alone": {"answers_arm": False},
    "omega is not measured": {"omega": math.nan},
    "text at power-up": {"boot_text": b"\r\nrig 1.0 ready\r\n"},
    "deaf at first": {"deaf_for": 0.12},
    "x runs the other way": {"greeting": (0x44524654, 9, 7, -1e-5, -1e-4, 2.0, 0.1, 50, 0)},
    "the watchdog in ticks of 20 ms": {"greeting": (0x44524654, 9, 7, 1e-5, 0, 2.0, 0, 60, 0)},
}


@pytest.mark.parametrize("ways", READINGS.values(), ids=READINGS)
@pytest.mark.parametrize("pause", [0.0, 1.0])
def test_a_rig_made_from_the_page_alone_can_be_driven(ways, pause):
    table = Table(OtherRig(**ways))
    table.session.connect(HELLO)
    table.clock.sleep_until(table.clock.now() + pause)
    table.session.arm(HOLD)
    table.drive(0.5)
    assert table.rig.state in (1, 2)
    newest = table.link.newest()
    assert newest is not None
    assert newest.frame.message.z == -1760
    assert table.session.emergency_stop(3)
    assert table.rig.state == 3


TRIES, GAP = DEFAULT_SESSION.tries, DEFAULT_SESSION.interval


def test_our_own_rig_can_be_driven():
    table = Table(ours()).ready()
    table.drive(0.5)
    assert table.rig.state is RigState.RUNNING
    table.session.stop()
    table.drive(0.1, omega=0.0)
    assert table.rig.state is RigState.ARMED
    table.session.bye()
    assert table.rig.state is RigState.IDLE


def test_a_run_follows_a_run():
    table = Table(ours())
    for _ in range(3):
        table.ready().drive(0.2)
        table.session.emergency_stop(1)
        assert table.rig.state is RigState.SAFE
    table.ready().drive(0.2)


def test_a_host_that_died_is_followed_by_another():
    table = Table(ours()).ready()
    table.drive(0.2)
    Table.__init__(again := Table.__new__(Table), table.rig)
    again.clock.sleep_until(table.clock.now())
    assert again.session.connect(HELLO).state is RigState.SAFE
    again.session.arm(HOLD)
    again.drive(0.2)
    assert again.rig.state is RigState.RUNNING


# Deadlines ---------------------------------------------------------------------------------------


def test_hello_is_said_five_times_50_ms_apart():
    table = Table(silent := Silent())
    with pytest.raises(InputError, match=r"no rig on port 1 answers HELLO .* not a byte came back"):
        table.session.connect(HELLO)
    assert silent.heard == pytest.approx([number * GAP for number in range(TRIES)])
    assert table.clock.now() == pytest.approx(TRIES * GAP, abs=ROUNDING)


def test_patience_tries_again_until_it_ends():
    table = Table(OtherRig(deaf_for=1.7))
    table.session.connect(HELLO, patience=3.0)
    assert 1.7 <= table.clock.now() < 1.7 + GAP
    table = Table(silent := Silent())
    with pytest.raises(InputError, match="no rig"):
        table.session.connect(HELLO, patience=1.1)
    assert len(silent.heard) == 5 * TRIES


def test_tries_and_their_interval_can_be_set():
    table = Table(silent := Silent())
    session = Session(table.link, table.clock, settings=SessionSettings(tries=2, interval=0.2))
    with pytest.raises(InputError, match=r"HELLO \(2 tries, 200 ms apart\)"):
        session.connect(HELLO)
    assert silent.heard == pytest.approx([0.0, 0.2])


def test_what_is_no_rig_is_told_by_what_it_says():
    table = Table(Silent(b"$GPGGA,123519\r\n\0"))
    with pytest.raises(InputError, match=r"80 bytes came \(.*\): is the baud rate the rig's"):
        table.session.connect(HELLO)


def test_arm_streams_the_command_at_rest_each_tick():
    table = Table(rig := OtherRig(answers_arm=False))
    table.session.connect(HELLO)
    rig.measure = lambda *_: None  # says nothing at all any more
    with pytest.raises(InputError, match="does not answer ARM"):
        table.session.arm(HOLD)
    assert rig.said.count(3) == TRIES
    # One more or less a try: at its first instant or its last.
    assert rig.said.count(4) == pytest.approx(TRIES * GAP / 0.01, abs=TRIES)


def test_an_emergency_stop_that_nobody_answers_says_so():
    table = Table(OtherRig()).ready()
    table.rig.say = lambda *_: None
    before = table.clock.now()
    assert not table.session.emergency_stop(1)
    assert table.clock.now() - before == pytest.approx(TRIES * GAP, abs=ROUNDING)


def test_what_was_heard_before_an_emergency_stop_does_not_answer_it():
    table = Table(OtherRig()).ready()
    table.rig.state = 3
    table.rig.report(2)
    table.rig.measure(0.0, 0)
    table.clock.sleep_until(table.clock.now() + 0.01)
    table.rig.say = lambda *_: None
    assert not table.session.emergency_stop(1)


# Rigs that cannot be driven ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("greeting", "said"),
    [
        ((1, 9, 1, 1e-5, 1e-4, 2.0, 0.1, 50, 0), "speaks schema 0x00000001"),
        ((0x44524654, 9, 1, math.nan, 1e-4, 2.0, 0.1, 50, 0), "z_scale nan"),
        ((0x44524654, 9, 1, 0.0, 1e-4, 2.0, 0.1, 50, 0), "z_scale 0"),
        ((0x44524654, 9, 1, 10.0, 1e-4, 2.0, 0.1, 50, 0), "z_scale 10"),
        ((0x44524654, 9, 1, 1e-5, math.inf, 2.0, 0.1, 50, 0), "x_scale inf"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, 0.0, 0.1, 50, 0), "omega_max 0"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, math.nan, 0.1, 50, 0), "omega_max nan"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, 2.0, -0.1, 50, 0), "vx_max -0.1"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, 2.0, 0.1, 0, 0), "a watchdog of 0 ms"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, 2.0, 0.1, 20, 0), "a watchdog of 20 ms, must be"),
        ((0x44524654, 9, 1, 1e-5, 1e-4, 2.0, 0.1, 500, 0), "a watchdog of 500 ms, must be"),
    ],
)
def test_a_rig_that_cannot_be_driven_safely_is_refused(greeting, said):
    with pytest.raises(InputError, match=said):
        Table(OtherRig(greeting=greeting)).session.connect(HELLO)


@pytest.mark.parametrize(("tick_ms", "rule"), [(1, 20), (5, 25), (10, 50), (20, 100), (77, 385)])
def test_a_watchdog_of_the_rules_length_up_to_twice_that_is_accepted(tick_ms, rule):
    def connect(watchdog_ms):
        greeting = (0x44524654, 9, 7, 1e-5, 1e-4, 2.0, 0.1, watchdog_ms, 0)
        Table(OtherRig(greeting=greeting)).session.connect(Hello(tick_ms * 1000, rule))

    connect(rule)
    connect(2 * rule)
    for beyond in (rule - 1, 2 * rule + 1):
        with pytest.raises(InputError, match=f"a watchdog of {beyond} ms, must be"):
            connect(beyond)


def test_a_rig_with_a_fault_is_not_armed():
    table = Table(ours())
    table.session.connect(HELLO)
    table.rig.fail(Reason.DRIVE, 3, 0.0)
    with pytest.raises(InputError, match="it says FAULT, reason 10"):
        table.session.arm(HOLD)


def test_nothing_can_be_armed_before_hello():
    with pytest.raises(InputError, match="no session is open"):
        Table(ours()).session.arm(HOLD)


# Stops of the rig --------------------------------------------------------------------------------


def test_a_rigs_emergency_stop_is_told_and_answered():
    table = Table(Buttons()).ready()
    table.drive(0.1)
    table.rig.press(12, table.clock.now())
    said = table.heard()
    with pytest.raises(RigStopped, match="emergency stop, reason 12"):
        table.drive(0.5)
    assert said[-1] == EmergencyStop(12)


RELEASE = r"made an emergency stop, reason 12 \(see its firmware\): release it and start again"


def test_a_rig_that_made_an_emergency_stop_since_hello_is_answered_and_not_armed():
    table = Table(Buttons())
    table.session.connect(HELLO)
    table.clock.sleep_until(0.2)
    table.rig.press(12, 0.2)
    table.clock.sleep_until(60.0)  # a question to the operator is open
    said = table.heard()
    for _ in range(2):  # it stays so
        with pytest.raises(InputError, match=RELEASE):
            table.session.arm(HOLD)
    assert set(said) == {EmergencyStop(12)}
    assert table.rig.protocol.state is RigState.SAFE


class PressedBy(Buttons):
    """The button is pressed as a message of the host's is on its way."""

    def __init__(self, message: type):
        super().__init__()
        self.message, self.left = message, 1

    def advance(self, now: float, data: bytes) -> bytes:
        if self.left and len(data) == wire_bytes(self.message):
            self.left -= 1
            if not self.left:
                self.press(12, now)
        return super().advance(now, data)


def test_an_emergency_stop_while_the_rig_is_being_armed_is_answered_and_ends_that():
    table = Table(PressedBy(Arm))
    table.session.connect(HELLO)
    said = table.heard()
    with pytest.raises(InputError, match=RELEASE):
        table.session.arm(HOLD)
    assert [each for each in said if not isinstance(each, Drive)] == [Arm(), EmergencyStop(12)]
    assert table.rig.protocol.state is RigState.SAFE


def test_an_emergency_stop_on_its_way_when_the_rig_is_greeted_anew_is_not_unlatched():
    table = Table(PressedBy(Hello))
    table.session.connect(HELLO)  # the button is pressed before it: that is over with HELLO
    table.session.require_no_rig_stop()
    table.rig.left = 1  # and once more, before the next
    table.rig.protocol.emergency_stop(3, 0.0)  # SAFE; the words of it are lost
    table.rig.protocol.advance(10.0, b"")
    with pytest.raises(InputError, match=RELEASE):
        table.session.arm(HOLD)
    assert table.rig.protocol.state is RigState.SAFE


def test_an_emergency_stop_is_not_lost_among_many_other_words():
    table = Table(rig := OtherRig())
    table.session.connect(HELLO)
    rig.say(7, struct.pack("<H", 12))
    for _ in range(3 * MOST_REPORTS):
        rig.report(0)
    table.clock.sleep_until(60.0)
    with pytest.raises(InputError, match=RELEASE):
        table.session.require_no_rig_stop()
    assert rig.said[-1] == 7
    assert len(table.link.reports()) <= MOST_REPORTS


def test_a_rig_that_went_safe_is_told():
    table = Table(ours()).ready()
    table.drive(0.1)
    table.clock.sleep_until(table.clock.now() + 0.2)
    with pytest.raises(RigStopped, match="went SAFE by itself, reason 1"):
        table.session.check()


def test_reasons_of_the_virtual_rig_are_told_in_words():
    def rig() -> RigProtocol:
        return RigProtocol(RigIdentity(boot_id=1, rig_id=VIRTUAL_RIG))

    table = Table(rig()).ready()
    table.drive(0.1)
    table.clock.sleep_until(table.clock.now() + 0.2)
    watchdog = r"went SAFE by itself, reason 1 \(watchdog: no valid command in time\)"
    with pytest.raises(RigStopped, match=watchdog):
        table.session.check()
    table = Table(rig())
    table.session.connect(HELLO)
    table.rig.fail(Reason.SENSOR, 3, 0.0)
    with pytest.raises(InputError, match=r"it says FAULT, reason 9 \(a sensor failed\)"):
        table.session.arm(HOLD)


def test_reasons_of_another_rig_are_its_firmwares():
    table = Table(ours()).ready()
    table.clock.sleep_until(table.clock.now() + 0.2)
    with pytest.raises(RigStopped, match=r"reason 1 \(see its firmware\)"):
        table.session.check()


def test_every_reason_has_words():
    assert set(REASON_MEANINGS) == set(Reason)


def test_a_state_that_only_measurements_tell_is_told():
    table = Table(OtherRig()).ready()
    table.rig.state = 3  # without a word
    with pytest.raises(RigStopped, match="went SAFE by itself"):
        table.drive(0.1)


def test_a_rig_that_was_reset_is_told():
    table = Table(Buttons()).ready()
    table.drive(0.1)
    table.rig.reset(table.clock.now())
    with pytest.raises(RigStopped, match="was reset during the run"):
        table.drive(0.1)


def test_words_of_an_earlier_boot_that_come_late_are_no_reset():
    table = Table(Buttons())
    late = StateReport(RigState.SAFE, 1, 77)
    table.rig.pressed = encode(Frame(late, 4, 999, 0))
    table.link.begin(1)
    table.clock.sleep_until(0.01)
    assert table.link.quality().foreign_state == late
    table.rig.pressed = encode(Frame(late, 4, 999, 0))
    table.ready().drive(0.1)
    assert table.link.quality().foreign_state is None


def test_a_rig_that_was_reset_before_arm_is_not_armed():
    table = Table(Buttons())
    table.session.connect(HELLO)
    table.rig.reset(0.0)
    with pytest.raises(InputError):
        table.session.arm(HOLD)
    assert table.rig.protocol.state is RigState.IDLE


def test_a_line_that_breaks_is_told_as_such():
    table = Table(OtherRig()).ready()
    table.rig.broken = True
    with pytest.raises(LinkLost, match="unplugged"):
        table.drive(0.1)
    with pytest.raises(LinkLost, match="unplugged"):
        table.session.emergency_stop(1)


def test_session_numbers_are_drawn_and_never_zero():
    numbers = {draw_session_number() for _ in range(2000)}
    assert len(numbers) > 1500
    assert min(numbers) >= 1
    assert max(numbers) <= 65_535


# Late answers ------------------------------------------------------------------------------------


class Late(OtherRig):
    """Its words are on the way for so long [s]."""

    delay = 0.9

    def __init__(self, **ways):
        super().__init__(**ways)
        self._way: list[tuple[float, bytes]] = []

    def advance(self, now, data):
        self._way.append((now + self.delay, super().advance(now, data)))
        arrived = b"".join(said for due, said in self._way if due <= now)
        self._way = [each for each in self._way if each[0] > now]
        return arrived


def late_session(delay: float) -> tuple[Session, list[int]]:
    """A session with a rig that answers so late, and the session numbers that it drew."""
    table, drawn = Table(Late(delay=delay)), []

    def number() -> int:
        drawn.append(100 + len(drawn))
        return drawn[-1]

    return Session(table.link, table.clock, number), drawn


def test_an_answer_later_than_five_tries_counts_and_is_told():
    session, drawn = late_session(0.9)
    assert session.connect(HELLO, patience=3.0).rig_id == 9
    assert drawn == [100]
    assert session.late_answer == "the rig on port 1 answered HELLO after 0.9 s"


def test_an_answer_in_time_is_not_called_late():
    session, _ = late_session(0.04)
    session.connect(HELLO)
    assert session.late_answer == ""


def test_a_rig_too_late_to_be_armed_is_told_as_late():
    session, _ = late_session(0.9)
    session.connect(HELLO, patience=3.0)
    with pytest.raises(InputError, match=r"not answer ARM .*; the rig .* answered HELLO after 0.9"):
        session.arm(HOLD)


def test_an_answer_to_an_earlier_hello_is_no_stranger():
    session, _ = late_session(0.3)
    for _ in range(2):
        with pytest.raises(InputError) as refused:
            session.connect(HELLO)
    assert "one answers late: an answer to an earlier HELLO came" in str(refused.value)
    assert "is it a rig?" not in str(refused.value)
