"""The rig's side in explicit time: when it may move, what makes it safe, and how it comes to rest.

Times are multiples of a millisecond; ramps and deadlines hold to a rounding error of sums.
"""

import math

import pytest

from hils.link.framing import Receiver
from hils.link.messages import (
    FROM_RIG,
    READY,
    U32,
    Arm,
    Bye,
    Drive,
    Drop,
    EmergencyStop,
    Frame,
    Hello,
    HelloAck,
    Measurement,
    Reason,
    RigState,
    StateReport,
    Stop,
    encode,
)
from hils.rig_sim.firmware import DEFAULT_FIRMWARE, FirmwareSettings, RigIdentity, RigProtocol

# A demand is a sum of slews over ticks of a clock that is rounded to 1e-13 s.
ROUNDING = 1e-9
TICK, WATCHDOG = 0.01, 0.05
BOOT = 77
GO = Drive(1.0, 0.125, True, 1000)
STILL = Drive(0.0, 0.0, False, 1000)


class Bench:
    """A host's hands on a rig: says things at its own pace and reads every answer."""

    def __init__(
        self,
        session: int = 5,
        seq: int = 0,
        settings: FirmwareSettings = DEFAULT_FIRMWARE,
        **identity,
    ):
        self.rig = RigProtocol(RigIdentity(boot_id=BOOT, **identity), settings=settings)
        self.session, self.seq, self.now = session, seq, 0.0

    def say(self, message, *, session: int | None = None, seq: int | None = None) -> list:
        self.seq = (self.seq + 1) & U32 if seq is None else seq
        session = self.session if session is None else session
        data = encode(Frame(message, session, self.seq, 0))
        return self.heard(self.rig.advance(self.now, data), session)

    def heard(self, data: bytes, session: int) -> list:
        receiver = Receiver(FROM_RIG)
        receiver.expect(session)
        return [frame.message for frame in receiver.feed(data)]

    def pause(self, duration: float, grain: float = 1e-3) -> list:
        end, out = self.now + duration, b""
        while self.now < end - ROUNDING:
            self.now = min(end, self.now + grain)
            out += self.rig.advance(self.now, b"")
        return self.heard(out, self.session)

    def drive(self, command: Drive, duration: float) -> list:
        heard = []
        for _ in range(round(duration / TICK)):
            heard += self.say(command) + self.pause(TICK)
        return heard

    def armed(self) -> "Bench":
        self.say(Hello(round(TICK * 1e6), 50))
        self.say(Arm())
        assert self.rig.state is RigState.ARMED
        return self

    def running(self) -> "Bench":
        self.armed().drive(GO, 0.5)
        assert self.rig.state is RigState.RUNNING
        assert self.rig.demand == (1.0, 0.125, True)
        return self


def states(heard: list) -> list[tuple[RigState, int]]:
    return [(each.state, each.reason) for each in heard if isinstance(each, StateReport)]


# From power-up to motion -------------------------------------------------------------------------


def test_hello_is_answered_with_the_rigs_limits():
    (answer,) = Bench(omega_max=2.0, vx_max=0.25, z_scale=2.0**-17).say(Hello(10_000, 50))
    assert isinstance(answer, HelloAck)
    assert (answer.boot_id, answer.omega_max, answer.vx_max) == (BOOT, 2.0, 0.25)
    assert (answer.z_scale, answer.watchdog_ms, answer.state) == (2.0**-17, 50, RigState.IDLE)


def test_nothing_moves_before_arm():
    bench = Bench()
    bench.say(Hello(10_000, 50))
    heard = bench.drive(GO, 0.3)
    assert bench.rig.demand == (0.0, 0.0, False)
    assert bench.rig.state is RigState.IDLE
    assert len(heard) == 30  # each command is answered all the same


def test_arm_needs_a_hello():
    bench = Bench()
    assert bench.say(Arm(), session=9) == [StateReport(RigState.IDLE, Reason.ANOTHER_SESSION, BOOT)]
    assert bench.rig.state is RigState.IDLE


def test_a_first_command_that_moves_makes_it_run():
    bench = Bench().armed()
    bench.say(STILL)
    assert bench.rig.state is RigState.ARMED
    bench.say(GO)
    assert bench.rig.state is RigState.RUNNING


def test_arm_is_answered_again_without_a_change():
    bench = Bench().running()
    assert states(bench.say(Arm())) == [(RigState.RUNNING, 0)]


def test_the_demand_follows_no_faster_than_the_slew_limits():
    bench = Bench(omega_slew=5.0, vx_slew=2.0).armed()
    bench.say(GO)
    for _ in range(40):
        before = bench.rig.demand
        bench.pause(1e-3)
        after = bench.rig.demand
        assert abs(after.omega - before.omega) <= 5e-3 + ROUNDING
        assert abs(after.vx - before.vx) <= 2e-3 + ROUNDING
    assert bench.rig.demand.omega == pytest.approx(0.2, abs=ROUNDING)
    assert bench.rig.demand.vx == pytest.approx(0.08, abs=ROUNDING)


def test_a_free_carriage_is_not_driven():
    bench = Bench().armed()
    bench.drive(Drive(1.0, 0.1, False, 1000), 0.3)
    assert bench.rig.demand == (1.0, 0.0, False)


# Measurements ------------------------------------------------------------------------------------


def test_each_command_is_answered_by_one_measurement():
    bench = Bench().armed()
    bench.rig.measure(-1760, 12, 0.25)
    for _ in range(5):
        assert bench.say(STILL) == [Measurement(bench.seq, -1760, 12, 0.25, RigState.ARMED, 0)]
        assert bench.pause(TICK) == []


def test_without_commands_a_measurement_comes_each_20_ms():
    bench = Bench()
    assert bench.pause(0.2) == []  # to whom?
    bench.say(Hello(10_000, 50))
    heard = bench.pause(1.0)
    assert {type(each) for each in heard} == {Measurement}
    assert len(heard) in (49, 50)  # the last one is due on the last instant


def test_who_calls_late_gets_one_measurement():
    bench = Bench()
    bench.say(Hello(10_000, 50))
    assert len(bench.pause(1.0, grain=1.0)) == 1


def test_counts_beyond_their_field_stay_at_its_end():
    bench = Bench()
    bench.say(Hello(10_000, 50))
    bench.rig.measure(1 << 40, -(1 << 40), 0.0)
    (answer,) = bench.say(STILL)
    assert (answer.z, answer.x) == (2**31 - 1, -(2**31))


# Refusals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        Drive(math.nan, 0.0, True, 50),
        Drive(math.inf, 0.0, True, 50),
        Drive(0.0, math.nan, True, 50),
        Drive(2.1, 0.0, True, 50),
        Drive(-2.1, 0.0, True, 50),
        Drive(0.0, 0.31, True, 50),
    ],
)
def test_a_command_past_the_limits_is_refused_and_does_not_feed_the_watchdog(command):
    bench = Bench().running()
    heard = bench.say(command)
    assert states(heard) == [(RigState.RUNNING, Reason.COMMAND_REFUSED)]
    assert isinstance(heard[-1], Measurement)
    assert bench.rig.demand == (1.0, 0.125, True)
    bench.drive(command, WATCHDOG)
    assert bench.rig.state is RigState.SAFE


def test_the_limit_itself_is_allowed_as_the_wire_rounds_it():
    bench = Bench(vx_max=0.3).armed()  # 0.3 is a little more in 32 bits
    bench.drive(Drive(-2.0, 0.3, True, 1000), 1.0)
    assert bench.rig.demand.omega == -2.0
    assert bench.rig.demand.vx == pytest.approx(0.3)


@pytest.mark.parametrize("tick_us", [0, 14_000_000])
def test_a_tick_that_cannot_be_opens_no_session(tick_us):
    bench = Bench()
    assert states(bench.say(Hello(tick_us, 50))) == [(RigState.IDLE, Reason.HELLO_REFUSED)]
    bench.say(Arm())
    assert bench.rig.state is RigState.IDLE


def test_another_schema_is_answered_but_opens_no_session():
    bench = Bench()
    (answer,) = bench.say(Hello(10_000, 50, schema=1))
    assert isinstance(answer, HelloAck)
    bench.say(Arm())
    assert bench.rig.state is RigState.IDLE


# Watchdog ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("grain", [1e-3, 7e-3, 2.0])
def test_silence_makes_it_safe_at_the_watchdog_and_ramps_to_rest(grain):
    bench = Bench(omega_slew=5.0).running()
    bench.say(GO)
    heard = bench.pause(WATCHDOG - 1e-3, grain=1e-3)
    assert bench.rig.state is RigState.RUNNING
    heard = bench.pause(2.0, grain)
    assert states(heard) == [(RigState.SAFE, Reason.WATCHDOG)]
    assert bench.rig.demand == (0.0, 0.0, True)


def test_the_wheel_ramps_and_the_carriage_stops_when_the_watchdog_bites():
    bench = Bench(omega_slew=5.0).running()
    bench.say(GO)
    bench.pause(WATCHDOG + 0.02)
    assert bench.rig.demand.vx == 0.0
    assert bench.rig.demand.omega == pytest.approx(1.0 - 5.0 * 0.02, abs=ROUNDING)


@pytest.mark.parametrize(("tick_us", "watchdog"), [(1000, 0.02), (10_000, 0.05), (100_000, 0.5)])
@pytest.mark.parametrize("asked_ms", [0, 65_535])
def test_the_watchdog_is_the_rigs_own_arithmetic(tick_us, watchdog, asked_ms):
    bench = Bench()
    (answer,) = bench.say(Hello(tick_us, asked_ms))
    assert answer.watchdog_ms == round(watchdog * 1e3)
    bench.say(Arm())
    bench.pause(watchdog - 1e-3)
    assert bench.rig.state is RigState.ARMED
    bench.pause(2e-3)
    assert bench.rig.state is RigState.SAFE


def test_a_command_lapses_after_its_own_time():
    bench = Bench().running()
    bench.say(Drive(1.0, 0.125, True, 20))
    bench.pause(0.03)
    assert bench.rig.state is RigState.RUNNING
    assert bench.rig.demand.omega == pytest.approx(1.0 - 5.0 * 0.01, abs=ROUNDING)
    bench.pause(0.03)
    assert bench.rig.state is RigState.SAFE


def test_stop_ramps_to_rest_and_stays_armed_while_commands_come():
    bench = Bench(omega_slew=5.0).running()
    assert states(bench.say(Stop())) == [(RigState.ARMED, Reason.HOST_STOPPED)]
    bench.pause(0.01)
    assert bench.rig.demand.omega == pytest.approx(0.95, abs=ROUNDING)
    bench.drive(STILL, 1.0)
    assert bench.rig.demand[:2] == (0.0, 0.0)
    assert bench.rig.state is RigState.ARMED


def test_stop_feeds_the_watchdog_for_the_time_of_one_ramp():
    bench = Bench(omega_slew=5.0).running()  # at 1 rad/s: 0.2 s
    bench.say(Stop())
    bench.pause(0.2 + WATCHDOG - 2e-3)
    assert bench.rig.state is RigState.ARMED
    bench.say(Stop())  # at rest it feeds no more
    bench.pause(3e-3)
    assert bench.rig.state is RigState.SAFE


# SAFE is latched ---------------------------------------------------------------------------------


def safe(bench: Bench) -> Bench:
    bench.running().pause(1.0)
    assert bench.rig.state is RigState.SAFE
    return bench


def test_safe_is_not_left_by_commands_or_arm_alone():
    bench = safe(Bench())
    bench.drive(GO, 0.2)
    assert states(bench.say(Arm())) == [(RigState.SAFE, Reason.HELLO_NEEDED)]
    bench.drive(GO, 0.2)
    assert bench.rig.demand[:2] == (0.0, 0.0)


def test_hello_leads_from_safe_to_idle_where_nothing_moves():
    bench = safe(Bench())
    (answer,) = bench.say(Hello(10_000, 50), session=6)
    assert answer.state is RigState.IDLE
    bench.session = 6
    bench.drive(GO, 0.2)
    assert bench.rig.state is RigState.IDLE
    assert bench.rig.demand[:2] == (0.0, 0.0)


def test_safe_is_not_left_before_the_wheel_rests():
    bench = Bench(omega_slew=5.0).running()
    bench.pause(WATCHDOG + 0.02)  # its ramp takes 0.2 s
    (answer,) = bench.say(Hello(10_000, 50))
    assert answer.state is RigState.SAFE
    assert states(bench.say(Arm())) == [(RigState.SAFE, Reason.WATCHDOG)]
    bench.pause(0.2)
    assert states(bench.say(Arm())) == [(RigState.ARMED, 0)]


@pytest.mark.parametrize("session", [5, 6])
def test_hello_and_arm_leave_safe(session):
    bench = safe(Bench())
    bench.session = session
    bench.say(Hello(10_000, 50))
    assert states(bench.say(Arm())) == [(RigState.ARMED, 0)]
    bench.drive(GO, 0.5)
    assert bench.rig.demand == (1.0, 0.125, True)


def test_an_emergency_stop_rests_at_once_and_latches():
    bench = Bench().running()
    assert states(bench.say(EmergencyStop(4))) == [(RigState.SAFE, Reason.HOST_STOPPED)]
    assert bench.rig.demand == (0.0, 0.0, True)
    bench.drive(GO, 0.2)
    bench.say(Arm())
    assert bench.rig.state is RigState.SAFE


def test_an_emergency_stop_before_arm_latches_too():
    bench = Bench()
    bench.say(Hello(10_000, 50))
    bench.say(EmergencyStop(4))
    bench.say(Arm())
    assert bench.rig.state is RigState.SAFE


@pytest.mark.parametrize("session", [5, 6])
@pytest.mark.parametrize("stage", ["armed", "running"])
def test_hello_while_armed_or_running_ends_the_session(stage, session):
    bench = getattr(Bench(), stage)()
    bench.say(Hello(10_000, 50), session=session)
    assert bench.rig.state is RigState.SAFE
    bench.session = session
    bench.drive(GO, 0.5)
    assert bench.rig.demand[:2] == (0.0, 0.0)
    bench.say(Arm())
    assert bench.rig.state is RigState.ARMED


@pytest.mark.parametrize("message", [GO, Arm(), Stop(), Bye()])
def test_another_session_makes_it_safe(message):
    bench = Bench().running()
    heard = bench.say(message, session=99)
    assert states(heard) == [(RigState.SAFE, Reason.ANOTHER_SESSION)]
    assert bench.rig.demand.omega > 0  # it ramps
    bench.drive(GO, 0.5)
    assert bench.rig.demand[:2] == (0.0, 0.0)
    assert bench.rig.drops == {Drop.SESSION: 1}


def test_an_emergency_stop_of_another_session_rests_at_once():
    bench = Bench().running()
    bench.say(EmergencyStop(1), session=99)
    assert bench.rig.demand[:2] == (0.0, 0.0)
    assert bench.rig.state is RigState.SAFE


def test_a_reset_rig_tells_a_host_of_its_new_boot_a_few_times_a_second():
    bench = Bench()
    bench.pause(0.1)
    heard = bench.drive(GO, 1.0)  # of a session from before the reset
    assert set(states(heard)) == {(RigState.IDLE, Reason.ANOTHER_SESSION)}
    assert 15 <= len(heard) <= 21
    assert heard[0].boot_id == BOOT


def test_bye_ends_the_session_at_rest():
    bench = Bench().running()
    assert states(bench.say(Bye())) == [(RigState.IDLE, Reason.BYE)]
    assert bench.pause(1.0) == []
    assert bench.rig.demand[:2] == (0.0, 0.0)
    bench.say(Arm())
    assert bench.rig.state is RigState.IDLE


def test_bye_does_not_leave_safe():
    bench = safe(Bench())
    bench.say(Bye())
    assert bench.rig.state is RigState.SAFE


# The rig's own stops -----------------------------------------------------------------------------


def stops(heard: list) -> int:
    return sum(isinstance(each, EmergencyStop) for each in heard)


def test_the_rigs_own_button_is_told_until_the_host_answers():
    bench = Bench().running()
    heard = bench.heard(bench.rig.emergency_stop(12, bench.now), 5)
    assert EmergencyStop(12) in heard
    assert bench.rig.demand[:2] == (0.0, 0.0)
    assert bench.rig.state is RigState.SAFE
    assert stops(bench.pause(1.0)) == DEFAULT_FIRMWARE.stop_tries - 1
    bench.rig.emergency_stop(12, bench.now)
    assert stops(bench.pause(0.06)) == 1
    bench.say(EmergencyStop(0))
    assert stops(bench.pause(1.0)) == 0


def test_the_rigs_own_button_is_told_as_often_as_is_set():
    bench = Bench(settings=FirmwareSettings(stop_tries=2, stop_interval=0.3)).running()
    bench.rig.emergency_stop(12, bench.now)
    assert stops(bench.pause(0.25)) == 0
    assert stops(bench.pause(1.0)) == 1


def test_a_fault_is_left_by_nothing_that_a_host_says():
    bench = Bench().running()
    bench.rig.fail(Reason.DRIVE, 3, bench.now)
    assert bench.rig.state is RigState.FAULT
    bench.say(EmergencyStop(0))
    bench.say(Hello(10_000, 50))
    bench.say(Arm())
    bench.say(Bye())
    assert bench.rig.state is RigState.FAULT
    bench.say(Hello(10_000, 50))
    (measured,) = bench.say(GO)
    assert (measured.state, measured.fault) == (RigState.FAULT, 3)
    assert bench.rig.demand[:2] == (0.0, 0.0)


# Order -------------------------------------------------------------------------------------------


def test_an_old_or_repeated_frame_is_dropped():
    bench = Bench().running()
    bench.drive(STILL, 0.5)
    seq = bench.seq
    assert bench.say(GO, seq=seq) == []
    assert bench.say(GO, seq=seq - 10) == []
    assert bench.rig.demand[:2] == (0.0, 0.0)
    assert bench.rig.drops == {Drop.ORDER: 2}


def test_sequence_numbers_wrap():
    bench = Bench(seq=U32 - 20).running()
    assert 0 < bench.seq < 100
    assert bench.rig.drops == {}


def test_a_session_starts_at_any_number():
    bench = Bench(seq=5000).armed()
    bench.say(Bye())
    bench.session, bench.seq = 8, 1
    bench.armed()


def test_what_only_a_rig_says_is_not_for_a_rig():
    bench = Bench().armed()
    bench.say(StateReport(RigState.IDLE, 0, 0))
    assert bench.rig.drops == {Drop.DIRECTION: 1}
    assert bench.rig.state in READY
