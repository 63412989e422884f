"""The loop and the procedure in virtual time, against the virtual rig: every end is a safe one."""

import math

import msgspec
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.check import check_file
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.header import Head
from drftjax.setups.setup import CommandSetUp
from drftjax.tuning.registry import TunerSetUp
from hils.control.limits import CommandLimits
from hils.control.loop import Overruns
from hils.control.loop_config import LoopRecord, LoopSetUp
from hils.control.stop_request import StopReason, StopRequest
from hils.events import Event, TickFlag
from hils.link.link import Arrival
from hils.link.messages import Bye, Drive, EmergencyStop, Frame, RigState, Stop
from hils.procedure.operator_prompts import UnattendedPrompts
from hils.procedure.procedure import Procedure, ZeroAt, run
from hils.recording.recorder import Recorder
from hils.recording.sinks import InMemorySink
from hils.replay import replay
from hils.rig_sim.faults import Disconnect, DriveFault, Fault, FaultScript, Reset, Window
from hils.rig_sim.in_process import soft_rig
from hils.rig_sim.sensors import Instruments
from hils.run_figure import plot_hils
from tests.helpers.hils_runs import (
    BEFORE,
    BORNE,
    CLOSE,
    PROFILE,
    START,
    TICK,
    TICKS,
    LoggedLink,
    Made,
    loop_setup,
    make,
    resting,
    whole,
)

# A few roundings of doubles of order one.
ROUNDING = 1e-15
# Times of a clock that starts at 1000 s are rounded to 1e-13 of a second; ten of them.
CLOCK = 1e-12
# The virtual rig's zeta. A wheel that has been let down stands some tenths of a millimetre deeper
# than statics has it, at 25 mm a zeta, and coarse plates carry a per cent otherwise.
RIGS_ZETA, STATICS = 0.7823, 0.04
# A free wheel slips by a per cent at so even a speed: the rest is the ripple of its grousers.
ROLLS = 0.02
# A sinkage is the difference of two means of some 30 readings, which scatter by 22 um: two such
# sinkages differ by 8 um; twice that.
SETTLED = 1.6e-5

# A run that is completed -------------------------------------------------------------------------


@pytest.mark.parametrize("tuner", ["step", "pi", "kalman"])
def test_run_is_completed_and_follows_the_rig(tuner):
    made = whole(tuner)
    report = made.report
    assert report.reason == "completed"
    assert report.completed
    assert report.rested
    assert report.loop.statistics.ticks == TICKS
    assert report.loop.statistics.overruns == 0
    assert float(np.abs(report.loop.statistics.error).max()) < CLOSE
    assert made.rows.end_reason == "completed"
    log = made.rows.run()
    assert log.source == "virtual rig"
    assert log.online is not None
    np.testing.assert_array_equal(log.online.time, np.arange(TICKS) * TICK)
    # A tick's command is for its end, and the first row for the start.
    np.testing.assert_array_equal(log.command.time, np.arange(TICKS + 1) * TICK)
    knots = np.interp(log.command.time, PROFILE.time, np.radians(PROFILE.omega))
    np.testing.assert_allclose(log.command.omega, knots, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(log.command.vx[1:-1], log.online.vx_sim[1:])
    # The sand bears the simulated wheel, which stands at first and then rolls steadily.
    weight = log.setup.mass_z * log.setup.gravity
    steady = np.r_[:40, 200:250]
    np.testing.assert_allclose(log.online.fz_sim[steady], weight, rtol=BORNE)
    apart = np.interp(log.measured.time, log.online.time, log.online.z_sim) - log.measured.z
    assert np.sqrt((apart**2).mean()) < CLOSE
    assert resting(made)


def test_nothing_is_commanded_before_arm_and_only_rest_before_the_start():
    made = whole("step")
    times = [time for time, message in made.said if isinstance(message, Drive)]
    armed = made.kinds().index(Event.ARMED)
    assert made.rows.events[armed][0] < 0.0  # times count from the start
    first = next(n for n, (_, m) in enumerate(made.said) if isinstance(m, Drive))
    assert [type(m).__name__ for _, m in made.said[:first]] == ["Hello", "Arm"]
    moving = [time for time, m in made.said if isinstance(m, Drive) and m.omega != 0]
    # `SettlingSettings.min_time`, at the least.
    assert min(moving) - times[0] > 2.0
    # From ARM on the watchdog never wants for a command.
    assert max(np.diff(times)) < 1.5 * TICK


def test_zeta_at_the_start_is_what_statics_tells():
    report = whole("step").report
    assert report.start.zeta == pytest.approx(RIGS_ZETA, rel=STATICS)
    given = make(zeta=0.9).report
    assert given.start.zeta == 0.9
    assert given.start.sinkage == report.start.sinkage


def test_stop_and_farewell_end_the_session():
    made = whole("step")
    stopped = next(n for n, (_, m) in enumerate(made.said) if isinstance(m, Stop))
    after = [m for _, m in made.said[stopped:]]
    assert all(isinstance(m, Stop) or (m.omega, m.vx) == (0.0, 0.0) for m in after[:-1])
    assert after[-1] == Bye()
    assert made.soft.rig.state is RigState.IDLE


def test_the_rigs_clock_goes_with_the_hosts_from_the_first_row_on():
    apart = [row.rig_time - row.time for row in whole("step").rows.ticks]
    # A reading is up to two ticks old, and the clocks drift apart by less.
    assert np.ptp(apart) < 3 * TICK


@pytest.mark.parametrize("tuner", ["step", "pi", "kalman"])
def test_rows_replay_to_the_same_zeta_bit_for_bit(tuner):
    check_replay(whole(tuner).rows)


def check_replay(rows: InMemorySink) -> None:
    """The ticks come out again, and every reading is one tick's."""
    assert replay(rows.run()).exact
    fresh = [row for row in rows.ticks if int(row.flags) & TickFlag.FRESH]
    assert len(fresh) == len(rows.readings)


def test_zeta_is_held_between_the_tuners_periods():
    made = make(loop_setup(tuning_ticks=5))
    zeta = np.array([row.zeta for row in made.rows.ticks])
    changed = np.flatnonzero(np.diff(zeta)) + 1
    assert len(changed) > 3
    assert np.diff(changed).min() >= 5
    check_replay(made.rows)


def test_free_carriage_is_recorded_and_nothing_is_simulated():
    made = make(free=True)
    assert made.report.completed
    log = made.rows.run()
    assert log.online is None
    assert log.command.vx is None
    drives = [m for _, m in made.said if isinstance(m, Drive)]
    assert not any(m.driven or m.vx for m in drives)
    # Up in a second, a second at 30 deg/s and down again.
    assert log.measured.x[-1] == pytest.approx(0.150 * np.radians(30.0) * 2.0, rel=ROLLS)
    # Readings come as ever, but for one or two in a hundred where the clocks slip past each other;
    # there is no sinkage to compare them with.
    assert made.report.loop.statistics.fresh > 0.98 * made.report.loop.statistics.ticks
    assert len(made.report.loop.statistics.error) == 0
    assert resting(made)


@pytest.mark.parametrize("free", [False, True])
def test_x_that_the_rig_does_not_measure_is_absent_from_the_log(tmp_path, free):
    path, scales = tmp_path / "run.h5", Instruments(x_scale=0.0)
    made = make(rows=Recorder(path), scales=scales, free=free)
    assert made.report.completed
    assert made.report.rested
    log = read_run(path)
    assert list(log.measured.channels()) == ["z"]
    assert check_file(path) == []
    plot_hils(log)
    if not free:
        np.testing.assert_allclose(log.measured.z[-1], log.online.z_sim[-1], rtol=0, atol=CLOSE)
        assert replay(log).exact


# Ends --------------------------------------------------------------------------------------------


def ask(reason: str = "asked", emergency: bool = False):
    wish = StopReason(reason, Event.STOP_ASKED)
    return lambda stop, link: stop.ask(wish, emergency)


def test_asked_to_stop_the_wheel_ramps_down():
    made = make(cue=ask(), at=2.0)
    assert made.report.reason == "asked"
    assert not made.report.completed
    assert made.report.rested
    assert made.rows.end_reason == "asked"
    omega = np.array([row[1] for row in made.rows.commands])
    assert omega[-1] == 0.0
    # 1 rad/s2, the loop's ramp: never a jump.
    assert np.abs(np.diff(omega)).max() < 1.0 * TICK + ROUNDING
    last = [row for row in made.rows.ticks if int(row.flags) & TickFlag.RAMPING]
    assert 40 < len(last) < 120
    assert len({row.zeta for row in last}) == 1
    assert {Event.STOP_ASKED, Event.RAMPED_DOWN, Event.STOP_SENT} <= set(made.kinds())
    check_replay(made.rows)
    assert resting(made)


def test_emergency_stop_is_said_at_once():
    made = make(cue=ask(emergency=True), at=2.0)
    assert made.report.reason == "emergency stop: asked"
    assert made.report.rested
    stopped = next(time for time, m in made.said if isinstance(m, EmergencyStop))
    # The first tick after the wish.
    assert stopped - (START + BEFORE + 2.0) < 2 * TICK
    assert made.soft.rig.state is RigState.SAFE
    assert resting(made)


def test_asked_to_stop_before_the_start_nothing_turns():
    made = make(cue=ask(), at=-1.0)
    assert made.report.reason == "asked"
    assert made.report.loop is None
    assert not any(isinstance(m, Drive) and m.omega for _, m in made.said)
    assert any(isinstance(m, Stop) for _, m in made.said)


def test_emergency_stop_before_the_start_is_called_so():
    made = make(cue=ask(emergency=True), at=-1.0)
    assert made.report.reason == "emergency stop: asked"
    assert made.report.loop is None
    assert made.soft.rig.state is RigState.SAFE


def test_stop_while_the_wheel_ramps_down_after_the_profile_leaves_the_run_completed():
    """The profile ends at 30 deg/s, from which the loop ramps down for half a second."""
    loop = loop_setup()
    setup = msgspec.structs.replace(
        loop.setup, command=CommandSetUp([0.0, 1.0, 2.0], [0, 30, 30], omega_unit="deg/s")
    )
    made = make(msgspec.structs.replace(loop, setup=setup), cue=ask(), at=1.9)
    assert made.report.completed
    assert made.report.reason == "completed"
    assert made.report.stop_reason.reason == "asked"
    kinds = made.kinds()
    assert kinds.index(Event.STOP_ASKED) < kinds.index(Event.PROFILE_ENDED)
    assert made.events(Event.STOP_ASKED) == [0.0]
    assert made.rows.ticks[-1].time > 2.0
    asked = next(time for time, code, _ in made.rows.events if code == Event.STOP_ASKED)
    assert 2.0 < asked < made.rows.ticks[-1].time


def test_rig_that_goes_safe_ends_the_run():
    made = make(cue=lambda stop, link: link.send(EmergencyStop(9)), at=2.0)
    assert made.report.reason == "the rig went SAFE, reason 4 (stopped by the host)"
    assert not made.report.completed
    assert made.rows.end_reason == made.report.reason
    assert made.events(Event.RIG_STATE) == [RigState.SAFE]
    assert resting(made)


class Pressed(LoggedLink):
    """The rig's own emergency stop is pressed."""

    pressed = None

    def reports(self):
        pressed, self.pressed = self.pressed, None
        found = super().reports()
        now = self._clock.now()
        return found if pressed is None else [*found, Arrival(Frame(pressed, 1, 1, 0), now)]


def press(stop, link):
    link.pressed = EmergencyStop(12)


def test_rigs_own_emergency_stop_after_the_profile_asks_for_no_further_run():
    made = make(cue=press, at=3.6, link=Pressed)
    assert made.report.completed
    assert made.report.stop_reason is not None
    assert made.report.stop_reason.reason == "the rig made an emergency stop, reason 12 (unknown)"
    assert any(isinstance(said, EmergencyStop) for _, said in made.said)
    assert made.soft.rig.state is RigState.SAFE
    assert_told_after_the_profile(made, Event.EMERGENCY_STOP, 12)
    assert resting(made)


def assert_told_after_the_profile(made, event, arg):
    kinds = made.kinds()
    assert made.events(event) == [arg]
    assert kinds.index(Event.PROFILE_ENDED) < kinds.index(event) < kinds.index(Event.DISCONNECTED)


@pytest.mark.parametrize(
    ("fault", "event", "arg", "reason"),
    [
        (
            DriveFault(7),
            Event.EMERGENCY_STOP,
            10,
            "the rig made an emergency stop, reason 10 (the drive failed)",
        ),
        (Reset(), Event.RIG_RESET, None, None),
        (Disconnect(), Event.LINK_LOST, 0.0, None),
    ],
)
def test_what_happens_to_the_rig_after_the_profile_is_in_the_log(fault, event, arg, reason):
    script = FaultScript((Fault(fault, Window("stop", 0.0, 0.02)),))
    soft, rows = soft_rig(script=script), InMemorySink()
    given = Procedure(loop=loop_setup(), countdown=0.3)
    report = run(given, soft.link, soft.clock, rows, UnattendedPrompts(quiet=True), StopRequest())
    assert report.completed
    assert (report.stop_reason and report.stop_reason.reason) == reason
    made = Made(report, rows, soft, [])
    found = made.events(event)
    assert len(found) == 1
    assert arg is None or found == [arg]
    assert made.kinds().index(Event.PROFILE_ENDED) < made.kinds().index(event)


def test_stop_that_is_asked_for_after_the_profile_is_in_the_log():
    made = make(cue=ask(), at=3.6)
    assert made.report.completed
    assert_told_after_the_profile(made, Event.STOP_ASKED, 0.0)


def test_what_ended_the_loop_is_in_the_log_once():
    for cue in (press, ask(), ask(emergency=True), lambda _, link: link.send(EmergencyStop(9))):
        made = make(cue=cue, at=2.0, link=Pressed)
        kinds = made.kinds()
        for each in (Event.EMERGENCY_STOP, Event.STOP_ASKED, Event.RIG_STATE):
            assert kinds.count(each) <= 1


def test_rigs_own_emergency_stop_is_answered_by_one():
    made = make(cue=press, at=2.0, link=Pressed)
    assert made.report.reason == "the rig made an emergency stop, reason 12 (unknown)"
    first = next(m for _, m in made.said if isinstance(m, EmergencyStop | Stop))
    assert first == EmergencyStop(12)
    assert made.report.rested
    assert resting(made)


# Deadlines ---------------------------------------------------------------------------------------


def test_ticks_that_were_slept_through_are_simulated_and_counted():
    made = make(at=2.0, late=0.0345)
    assert made.report.completed
    assert made.report.loop.statistics.skipped == 3
    assert made.report.loop.statistics.overruns == 3
    assert made.events(Event.TICKS_SKIPPED) == [3.0]
    numbers = np.array([round(row.time / TICK) for row in made.rows.ticks])
    gaps = np.diff(numbers)
    assert sorted(gaps)[-2:] == [1, 4]
    after = made.rows.ticks[int(np.argmax(gaps)) + 1]
    assert int(after.flags) & TickFlag.SKIPPED
    # Late is counted from the first tick that was slept through, not from the last.
    assert int(after.flags) & TickFlag.LATE
    assert after.late == pytest.approx(0.0345 - TICK, abs=CLOCK)
    assert made.report.loop.statistics.wake_delay.max() == pytest.approx(0.0345, abs=CLOCK)
    assert made.events(Event.OVERRUN) == pytest.approx([0.0345 - TICK], abs=CLOCK)
    assert [row.late for row in made.rows.ticks if row is not after] == [0.0] * (TICKS - 4)
    check_replay(made.rows)


def test_policy_stop_ends_the_run_at_the_first_missed_deadline():
    made = make(at=2.0, late=0.0145, overruns=Overruns.STOP)
    assert made.report.reason.startswith("a deadline was missed by")
    assert not made.report.completed
    assert made.report.rested
    assert made.rows.commands[-1][1] == 0.0


def test_sleep_longer_than_the_watchdog_finds_the_rig_safe():
    made = make(at=2.0, late=0.2)
    watchdog = "reason 1 (watchdog: no valid command in time)"
    assert made.report.reason.startswith(f"the rig went SAFE, {watchdog}; this computer sent no ")
    assert not made.report.completed
    assert resting(made)


def test_scale_that_was_zeroed_before_need_not_be_zeroed_again():
    """The virtual rig hangs at touch-down with a scale that is a few counts off."""
    held, before = whole("step").report, make(zero=ZeroAt.POWER_UP).report
    assert before.completed
    assert abs(held.start.sinkage - before.start.sinkage) < SETTLED


# What is refused before anything moves -----------------------------------------------------------


def refused(**changes) -> str:
    with pytest.raises(InputError) as refusal:
        make(**changes)
    return str(refusal.value)


def test_profile_that_the_rig_does_not_allow_is_refused_before_arm():
    fast = msgspec.convert(msgspec.to_builtins(loop_setup()), LoopSetUp)
    fast.setup.command.omega = [0, 0, 150, 150, 0, 0]
    fast = msgspec.structs.replace(fast, commands=CommandLimits(5.0, 1.0))
    assert "the rig allows 2 rad/s at most" in refused(loop=fast)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"zeta": 50.0}, "zeta0 is 50, must lie between"),
        ({"countdown": math.nan}, "countdown is nan, must lie between"),
        ({"loop": loop_setup(ramp=100.0)}, "ramp is 100, must lie between"),
        ({"loop": msgspec.structs.replace(loop_setup(), tick=1e-5)}, "tick is 1e-05, must lie"),
    ],
)
def test_numbers_that_cannot_be_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        make(**changes)


def test_unknown_number_of_a_tuner_is_refused():
    with pytest.raises(InputError, match="has no number 'gain', it has zeta_step, tolerance"):
        TunerSetUp("step", {"gain": 1.0}).build(TICK)


def test_record_of_the_loop_reads_back_as_it_was():
    head = whole("kalman").rows.head
    assert isinstance(head, Head)
    assert head.online is not None
    assert head.online.loop is not None
    text = LoopRecord.read(head.online.loop).text()
    assert LoopRecord.read(text) == LoopRecord.read(head.online.loop)
    assert LoopRecord.read(text).text() == text
    with pytest.raises(InputError, match="cannot be read"):
        LoopRecord.read("{}")
