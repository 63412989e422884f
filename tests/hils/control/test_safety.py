"""Rules of safety one by one, on readings and commands made by hand."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hils.control.compiled_step import StepResult
from hils.control.limits import CommandLimits, Reading, ReadingMonitor, RigCommand, Verdict
from hils.control.measurements import PolledReading, ResponseSettings, SampleClock
from hils.control.safety import (
    DEFAULT_SAFETY,
    MotionAtRest,
    SafetyMonitor,
    SafetyRule,
    safety_table,
)
from hils.control.tick import TickOutput
from tests.helpers.hils_runs import loop_setup

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guide" / "run-a-rig.md"
TICK, OMEGA, VX = 0.01, 0.5, 0.07


def monitor(tick: float) -> SafetyMonitor:
    loop = msgspec.structs.replace(loop_setup(), tick=tick, commands=CommandLimits(2.0, 0.3))
    return SafetyMonitor(loop, True)


def rules(
    seconds: float,
    omega=None,
    x=None,
    z_sim=None,
    vx=None,
    zeta=0.8,
    at_bound=False,
    tick: float = TICK,
):
    """Rules that fire in a drive at constant speed, with the time of each; functions of time."""
    safety = monitor(tick)
    found = {}
    travelled = 0.0
    for number in range(round(seconds / tick)):
        time = number * tick
        asked = VX if vx is None else vx(time)
        height = -0.02 if z_sim is None else z_sim(time)
        result = StepResult(0.0, zeta, 0.0, height, asked, 0.0, 0.0, 0.0)
        command = RigCommand(OMEGA, VX)
        travelled += VX * tick if number else 0.0
        reading = Reading(
            time,
            travelled if x is None else x(time),
            -0.02,
            OMEGA if omega is None else omega(time),
        )
        output = TickOutput(
            *(number, command, result, result, command, RigCommand(OMEGA, asked), False),
            *(Verdict.USED, False, False, at_bound),
        )
        polled = PolledReading(reading, False, 0.0, 0.0, 1, 1, time, 2, 0)
        for each in safety.find(output, ReadingMonitor(time, -0.02), polled, False):
            found[each.rule] = time
    return found


@pytest.mark.parametrize("tick", [0.001, 0.002, 0.01, 0.03, 0.1])
def test_a_sound_drive_breaks_no_rule(tick):
    assert rules(3.0, tick=tick) == {}


def test_noise_and_what_is_not_measured_break_no_rule():
    random = np.random.default_rng(3)
    assert rules(3.0, omega=lambda t: OMEGA + 0.03 * random.standard_normal()) == {}
    assert rules(3.0, omega=lambda t: math.nan, x=lambda t: math.nan) == {}


@pytest.mark.parametrize("wrong", [10.0, -0.4, math.inf, 2.5])
def test_a_wheel_that_runs_away_is_found_at_its_third_reading(wrong):
    found = rules(2.0, omega=lambda t: wrong if t > 0.995 else OMEGA)
    assert found == {SafetyRule.RUNAWAY: pytest.approx(1.02)}


def test_two_wrong_readings_are_none():
    assert rules(2.0, omega=lambda t: 10.0 if 0.995 < t < 1.015 else OMEGA) == {}


def test_a_drive_that_is_a_third_off_is_found_after_a_second():
    found = rules(4.0, omega=lambda t: OMEGA * 1.34 if t > 0.995 else OMEGA)
    assert found == {SafetyRule.DRIVE_DEVIATES: pytest.approx(2.0, abs=0.02)}


@pytest.mark.parametrize("share", [0.0, -1.0, 0.5, 2.0])
def test_a_carriage_that_does_not_follow_is_found(share):
    def x(time: float) -> float:
        return VX * (min(time, 1.0) + share * max(time - 1.0, 0.0))

    found = rules(3.0, x=x)
    assert list(found) == [SafetyRule.CARRIAGE_DEVIATES]
    # 20 % of 35 mm and 3 mm: at once for the wrong way, after 0.3 s for half the speed.
    assert 1.05 < found[SafetyRule.CARRIAGE_DEVIATES] < 1.4


def test_a_carriage_that_is_a_tenth_off_is_a_matter_for_a_diagnosis():
    assert rules(3.0, x=lambda t: 1.1 * VX * t) == {}


def test_a_simulation_that_falls_or_races_is_found():
    assert list(rules(2.0, z_sim=lambda t: -0.02 - 0.115 * max(t - 1, 0))) == [
        SafetyRule.SIMULATION_JUMPS
    ]
    assert rules(2.0, z_sim=lambda t: -0.02 - 0.03 * max(t - 1, 0)) == {}
    assert list(rules(2.0, vx=lambda t: 0.12 if t > 1 else VX)) == [SafetyRule.SPEED_DOUBTED]
    assert list(rules(2.0, vx=lambda t: -0.02 if t > 1 else VX)) == [SafetyRule.SPEED_DOUBTED]
    assert list(rules(2.0, at_bound=True)) == [SafetyRule.ZETA_AT_BOUND]


def test_a_rig_that_must_stand_is_seen_to_move_and_noise_is_none():
    random = np.random.default_rng(5)
    still = MotionAtRest(1e-5)
    for _ in range(500):
        assert still.find(0.1 * random.standard_normal(), 100 + random.integers(-5, 5)) is None
    turning, going = MotionAtRest(1e-5), MotionAtRest(1e-5)
    seen = [turning.find(-1.5, 0.0) for _ in range(10)]
    assert [each is not None for each in seen] == [False] * 9 + [True]
    seen = [going.find(math.nan, 0.0)] + [going.find(math.nan, 600.0) for _ in range(3)]
    assert [each is not None for each in seen] == [False] * 3 + [True]


def test_the_age_of_a_sample_is_told_by_the_clock_of_the_rig():
    clock = SampleClock(ResponseSettings())
    for number in range(100):
        age = clock.age(5.0 + 0.01 * number, 900.0 + 0.01 * number, 0.004)
    assert age == pytest.approx(0.002)  # half of the round trip
    for number in range(100, 130):  # the same sample again and again
        age = clock.age(5.0 + 0.01 * number, 900.99, 0.004)
    assert age == pytest.approx(0.002 + 0.3, abs=1e-9)
    set_back = clock.age(6.3, 100.0, 0.004)
    assert set_back == pytest.approx(0.002)


def test_the_page_shows_the_rules_as_they_stand_in_the_code():
    """`python -c "from hils.control.safety import safety_table as t; print(t())"` writes them."""
    assert safety_table(DEFAULT_SAFETY) in PAGE.read_text(encoding="utf-8")
