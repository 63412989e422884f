"""Plates of a simulated wheel: what their length makes of the forces is held against no model."""

import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.gap.discretization_error import beside_plates, plate_changes
from diagnose.pipeline import diagnose
from drftjax.effects.catalogue import effect_class
from drftjax.recorded.prepared_run import PreparedRun
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

TIME, OMEGA, RADIUS = [0.0, 0.3, 1.0, 2.5], [0.0, 0.0, 0.8, 0.8], 0.150
CHANNELS = ("z", "fx", "fz", "torque")
# An effect that gains nothing costs 1.5 for its number and is less likely than none by 0.5 to
# begin with: 0.12 at most. As a delay the plates would have 0.28.
BY_CHANCE = 0.12


def driven(plate_share: float, number: int, ratio: float) -> PreparedRun:
    """A run of a driven carriage, recorded with plates of this share of the model's length."""
    setup = setup_of((TIME, OMEGA), vx=[RADIUS * ratio * omega for omega in OMEGA])
    setup.wheel.plate_size *= plate_share
    return coarse(f"run {number}", recorded(setup, number, channels=CHANNELS, force_noise=0.01))


def of(residual: float, change: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Two runs whose residuals are shares of the changes, in one channel of two."""
    wave = np.sin(np.arange(50.0))
    changes = [np.stack([0 * wave, size * change * wave]) for size in (1.0, 3.0)]
    return [residual * each for each in changes], changes


def test_one_share_of_the_changes_is_taken_off_all_runs():
    missed, changes = of(-0.7, 2.0)
    # Rounding of sums of fifty numbers.
    assert max(np.abs(each).max() for each in beside_plates(missed, changes)) < 1e-12


@pytest.mark.parametrize(("share", "left"), [(0.4, 0.4), (-2.5, -0.5)])
def test_no_less_is_taken_off_than_nothing_and_no_more_than_all_plates(share, left):
    missed, changes = of(share, 1.0)
    for each, change in zip(beside_plates(missed, changes), changes, strict=True):
        assert each == pytest.approx(left * change)


def test_without_forces_nothing_is_taken_off(pool):
    dataset = RigDataset.of([coarse("free", recorded(setup_of((TIME, OMEGA))))])
    changes = plate_changes(dataset, np.zeros(1), pool)
    assert not np.any(changes[0])
    left = [np.ones_like(changes[0])]
    assert np.array_equal(beside_plates(left, changes)[0], left[0])


def test_plates_that_come_to_bear_later_are_no_delay_of_the_instruments():
    """Recorded with plates a third as long; what a delay gains in the forces is their share."""
    ratios = enumerate((0.5, 0.9, 1.3))
    dataset = RigDataset.of([driven(1 / 3, number, ratio) for number, ratio in ratios])
    found = diagnose(dataset, [effect_class("channel_delay"), effect_class("surface_slope")])
    assert found.verdict == ("none",)
    assert found.weights["channel_delay"] < BY_CHANCE
