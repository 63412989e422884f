"""The guard: which readings count, which commands may be asked, which profiles can be begun."""

import math

import numpy as np
import pytest

from drftjax.common.errors import InputError
from hils.control.limits import (
    CommandLimits,
    Reading,
    ReadingLimits,
    ReadingMonitor,
    RigCommand,
    SensorMotionSettings,
    Verdict,
    check_reading,
    limit_command,
    require_profile,
)

TICK = 0.01
LIMITS = ReadingLimits()
START = ReadingMonitor(0.0, -0.0176)
COMMANDS = CommandLimits(omega=2.0, vx=0.3, omega_slew=5.0, vx_slew=1.0)
# Sums of decimals.
SAME = 1e-12


def reading(time: float, z: float, omega: float = 0.5) -> Reading:
    return Reading(time, 0.0, z, omega)


def follow(readings: list[Reading], omega: float = 0.5) -> tuple[ReadingMonitor, list[Verdict]]:
    watch, verdicts = START, []
    for each in readings:
        watch, verdict = check_reading(LIMITS, watch, each, omega)
        verdicts.append(verdict)
    return watch, verdicts


# Readings ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("z", "verdict"),
    [
        (-0.0176, Verdict.USED),
        (-0.0186, Verdict.USED),
        (-0.0220, Verdict.JUMP),
        (-0.0130, Verdict.JUMP),
        (0.2, Verdict.OUTSIDE),
        (-0.2, Verdict.OUTSIDE),
        (math.nan, Verdict.OUTSIDE),
        (math.inf, Verdict.OUTSIDE),
        (-math.inf, Verdict.OUTSIDE),
    ],
)
def test_reading_that_the_wheel_cannot_have_made_is_refused(z, verdict):
    watch, found = check_reading(LIMITS, START, reading(TICK, z), 0.5)
    assert found is verdict
    assert watch.refused == (0 if verdict is Verdict.USED else 1)
    assert watch.z == (z if verdict is Verdict.USED else START.z)


def test_jump_is_judged_from_the_last_reading_used_and_the_time_since():
    far = -0.0176 - LIMITS.slack - LIMITS.fastest * 0.05
    assert follow([reading(0.05, far + 1e-6)])[1] == [Verdict.USED]
    assert follow([reading(0.05, far - 1e-6)])[1] == [Verdict.JUMP]
    # A refused reading does not become the new standard.
    watch, verdicts = follow([reading(TICK, 0.04), reading(2 * TICK, -0.0177)])
    assert verdicts == [Verdict.JUMP, Verdict.USED]
    assert watch.refused == 0


def test_refused_readings_are_counted_in_a_row():
    absurd = [reading(TICK * n, 0.5) for n in range(1, 5)]
    assert follow(absurd)[0].refused == 4
    assert follow([*absurd, reading(0.05, -0.0176)])[0].refused == 0


def test_rig_that_does_not_measure_its_turning_is_believed():
    watch, verdicts = follow([reading(TICK * n, -0.0176, math.nan) for n in range(1, 200)])
    assert set(verdicts) == {Verdict.USED}
    assert not watch.drive_off


def test_sensor_is_stuck_only_while_the_wheel_turns():
    still = [reading(TICK * n, -0.0176) for n in range(1, 120)]
    assert follow(still)[0].stuck
    assert not follow(still[:90])[0].stuck
    assert not follow(still, omega=0.0)[0].stuck
    assert not follow([*still, reading(1.21, -0.01761)])[0].stuck


def test_drive_that_lags_is_flagged_after_a_while_and_cleared():
    slow = [reading(TICK * n, -0.0176 - 1e-5 * n, 0.3) for n in range(1, 80)]
    assert follow(slow)[0].drive_off
    assert not follow(slow[:40])[0].drive_off
    assert not follow([*slow, reading(0.81, -0.0184, 0.5)])[0].drive_off


def travelling(
    readings: list[float], vx: float, limits: ReadingLimits
) -> tuple[ReadingMonitor, Verdict]:
    """What is remembered after these readings of x, a tick apart, and the last one's verdict."""
    watch, verdict = START, Verdict.USED
    for number, x in enumerate(readings, start=1):
        z = START.z - 1e-5 * number
        watch, verdict = check_reading(limits, watch, Reading(TICK * number, x, z, 0.5), 0.5, vx)
    return watch, verdict


def test_a_jump_of_x_is_refused_and_one_that_is_not_measured_is_none():
    limits = ReadingLimits(fastest_x=0.6)
    far = limits.slack_x + limits.fastest_x * TICK
    assert travelling([5.0], 0.1, limits)[1] is Verdict.USED  # the first tells where it starts
    assert travelling([5.0, 5.0 + far - 1e-6], 0.1, limits)[1] is Verdict.USED
    watch, verdict = travelling([5.0, 5.0 - far - 1e-6], 0.1, limits)
    assert verdict is Verdict.JUMP_OF_X
    assert (watch.x, watch.refused) == (5.0, 1)
    assert travelling([math.nan] * 3, 0.1, limits)[1] is Verdict.USED


def test_x_is_stuck_only_while_the_carriage_is_driven():
    still = [0.3] * 120
    assert travelling(still, 0.05, LIMITS)[0].x_stuck
    assert not travelling(still[:90], 0.05, LIMITS)[0].x_stuck
    assert not travelling(still, 0.0, LIMITS)[0].x_stuck
    assert not travelling([*still, 0.3001], 0.05, LIMITS)[0].x_stuck
    assert not travelling([math.nan] * 120, 0.05, LIMITS)[0].x_stuck


# Commands ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "asked",
    [(2.1, 0.0), (-2.1, 0.0), (0.0, 0.31), (math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0)],
)
def test_demand_beyond_the_limits_is_refused_and_not_clipped(asked):
    assert limit_command(COMMANDS, RigCommand(0.0, 0.0), RigCommand(*asked), TICK) is None


def test_demand_within_the_limits_passes_as_it_is():
    asked = RigCommand(0.5, 0.08)
    assert limit_command(COMMANDS, RigCommand(0.49, 0.079), asked, TICK) == (asked, False)


def test_sudden_demand_is_held_to_the_slew_limits_and_says_so():
    found = limit_command(COMMANDS, RigCommand(0.5, 0.08), RigCommand(-1.0, 0.2), TICK)
    assert found is not None
    demand, held_back = found
    assert held_back
    np.testing.assert_allclose(demand, (0.45, 0.09), rtol=0, atol=SAME)


# Profiles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("omega", "said"),
    [
        ([0, 2.5, 0], "asks for 2.5 rad/s at 1 s, the rig allows 2 rad/s at most"),
        ([0.1, 0.1, 0], "starts with 0.1 rad/s at 0 s, it must start at rest"),
        ([0, -2.5, 0], "asks for -2.5 rad/s"),
    ],
)
def test_profile_that_cannot_be_commanded_is_refused(omega, said):
    with pytest.raises(InputError, match=said):
        require_profile(np.array([0.0, 1.0, 2.0]), np.array(omega, float), COMMANDS, "the rig")


def test_profile_that_changes_too_fast_is_refused():
    with pytest.raises(InputError, match=r"changes by 20 rad/s2 after 1 s, 5 rad/s2 are allowed"):
        require_profile(np.array([0, 1, 1.1]), np.array([0.0, 0.0, 2.0]), COMMANDS, "the loop")


def test_a_wheel_that_turns_slower_than_is_set_need_not_show_it_in_its_height():
    def stuck(motion: SensorMotionSettings) -> bool:
        watch = START
        for each in range(200):
            watch, _ = check_reading(LIMITS, watch, reading(each * TICK, -0.0176), 0.5, 0.0, motion)
        return watch.stuck

    assert stuck(SensorMotionSettings())
    assert not stuck(SensorMotionSettings(min_omega=0.6))
