"""Runs whose wheel's speed was measured: which error of the drive shows in it, and what is left."""

from dataclasses import replace

import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.drive_error import drive_error, driven_by_measured_speed
from diagnose.model.augmented_model import AugmentedModel
from drftjax.effects.drive import DRIVE, SpeedGain, SpeedRipple
from drftjax.effects.surface import SurfaceSlope
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# Of an encoder whose speed is read a hundred times a second [rad/s].
NOISE = 2e-3
RATE = 100.0
# Three standard errors: of 13 numbers none is farther out but by a mistake.
ERRORS = 3.0
# The play's ends and the fit's steps are rounded by so much of a number [-].
MODELLED = 0.05
ZETA = 0.75
# Integrating an encoder's noise over 4 s at 100 Hz leaves 4e-4 rad, 0.04 mm of the rim; the run
# that the command drives is off by 3 % of 0.16 m, a hundred times as much [m].
LEFT, COMMANDED = 2e-4, 2e-3
PROFILE = [0.0, 0.3, 1.3, 3.3, 3.5, 4.0], [0.0, 0.0, 0.6, 0.6, -0.5, -0.5]


def speed_of(kind, command_time, command_omega, **numbers):
    """Wheel speed by the textbook, in steps far shorter than a reading's [rad/s]."""
    time = np.arange(0.0, command_time[-1], 1e-4)
    asked = np.interp(time, command_time, command_omega)
    if kind == "speed_gain":
        return time, (1 + numbers["gain"]) * asked
    if kind == "speed_lag":
        found = np.zeros_like(asked)
        for row in range(1, len(time)):
            found[row] = found[row - 1] + 1e-4 / numbers["lag"] * (asked[row] - found[row - 1])
        return time, found
    if kind == "speed_ripple":
        found, angle = np.zeros_like(asked), 0.0
        for row in range(len(time)):
            turned = numbers["order"] * angle
            wave = numbers["cosine"] * np.cos(turned) + numbers["sine"] * np.sin(turned)
            found[row] = (1 + wave) * asked[row]
            angle += 1e-4 * found[row]
        return time, found
    assert kind == "backlash"
    # The play is taken up on the way, and crossed again when the sense changes.
    turned = np.clip(np.cumsum(asked) * 1e-4, 0, None)
    reversal = np.argmax(asked < 0)
    back = np.cumsum(np.where(np.arange(len(time)) >= reversal, -asked, 0)) * 1e-4
    free = (turned < numbers["play"]) & (np.arange(len(time)) < reversal)
    crossing = (back > 0) & (back < 2 * numbers["play"])
    return time, np.where(free | crossing, 0.0, asked)


def with_speed(log, time, speed, seed=0):
    """The run with a measured speed of its wheel, and an encoder's noise."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(log.measured.time))
    omega = np.interp(log.measured.time, time, speed) + noise
    return replace(log, measured=replace(log.measured, omega=omega))


@pytest.fixture(scope="module")
def log():
    """A run of a wheel that turns 3 % faster than commanded, whose own speed was not measured."""
    setup = setup_of(PROFILE)
    setup.effects = [{"name": "speed_gain", "gain": 0.03}]
    return recorded(setup, rate=RATE)


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("speed_gain", {"gain": 0.03}),
        ("speed_lag", {"lag": 0.08}),
        ("speed_ripple", {"cosine": 0.02, "sine": -0.03, "order": 16.0}),
        ("backlash", {"play": 0.12}),
    ],
)
def test_the_error_of_a_drive_is_named_with_its_numbers(log, kind, numbers):
    run = with_speed(log, *speed_of(kind, *PROFILE, **numbers))
    found = drive_error([coarse("run", run)], DRIVE)
    assert found is not None
    assert found.effect is not None, found.sentences()
    # A ripple's form with a second harmonic describes it as well, with numbers to spare.
    assert found.effect.about.name == kind
    assert found.explained > 0.9
    for name, (value, error, _) in (found.numbers or {}).items():
        assert abs(value - numbers[name]) < ERRORS * error + MODELLED * abs(numbers[name]), name
    if isinstance(found.effect, SpeedRipple):
        assert float(found.effect.order) == numbers["order"]
    assert kind in found.sentences()[0]


def test_a_wheel_that_turns_as_commanded_has_no_error(log):
    found = drive_error([coarse("run", with_speed(log, *PROFILE))], DRIVE)
    assert found is not None
    assert found.effect is None
    assert found.sentences()[0].startswith("The wheel turned as commanded")


def test_an_error_that_no_effect_explains_is_not_put_down_to_one(log):
    time = np.arange(0.0, 4.0, 1e-3)
    wandering = np.interp(time, *PROFILE) + 0.05 * np.sin(2 * np.pi * time)
    found = drive_error([coarse("run", with_speed(log, time, wandering))], (SpeedGain,))
    assert found is not None
    assert found.effect is None
    assert "No effect of the drive" in found.sentences()[0]


def test_a_logged_command_is_no_measured_speed(log):
    command = np.interp(log.measured.time, *PROFILE)
    run = replace(log, measured=replace(log.measured, omega=command))
    assert drive_error([coarse("run", run)], DRIVE) is None


def test_a_run_is_driven_by_the_measured_speed_in_place_of_effects_of_the_drive(log):
    run = coarse("run", with_speed(log, PROFILE[0], 1.03 * np.array(PROFILE[1])))
    driven, effects = driven_by_measured_speed([run], (SpeedGain, SurfaceSlope))
    assert effects == (SurfaceSlope,)
    gaps = []
    for each in (run, *driven):
        dataset = RigDataset.of([each])
        x = dataset.channels.index("x")
        believed = each.setup.terrain.zeta
        assert isinstance(believed, float)
        zeta = float(np.log(ZETA / believed))
        found = dataset.prediction(AugmentedModel(), 0, zeta, np.zeros(0))[x]
        gaps.append(np.abs(found - dataset.recording(0)[x]).max())
    commanded, measured = gaps
    assert commanded > COMMANDED
    assert measured < LEFT


def test_runs_of_which_one_has_no_measured_speed_stay_as_commanded(log):
    with_it, without = coarse("a", with_speed(log, *PROFILE)), coarse("b", log)
    driven, effects = driven_by_measured_speed([with_it, without], (SpeedGain, SurfaceSlope))
    assert driven == [with_it, without]
    assert effects == (SpeedGain, SurfaceSlope)
    assert drive_error([with_it, without], DRIVE) is None
