"""Plates of a simulated wheel: what their length makes of the forces is held against no model."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnose.dataset import RigDataset
from diagnose.gap.discretization_error import beside_plates, of_positions
from diagnose.model.augmented_model import AugmentedModel
from diagnose.pipeline import diagnose
from diagnose.unknown.settings import UnknownEffectSettings
from drftjax.effects.catalogue import effect_class
from drftjax.recorded.prepared_run import PreparedRun
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN, dataset_with
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

TIME, OMEGA, RADIUS = [0.0, 0.3, 1.0, 2.5], [0.0, 0.0, 0.8, 0.8], 0.150
CHANNELS = ("z", "fx", "fz", "torque")
# An effect that gains nothing costs 1.5 for its number and is less likely than none by 0.5 to
# begin with: 0.12 at most. As a delay the plates would have 0.28.
BY_CHANCE = 0.12
# Where an effect is sure, or sure not to be.
SURE = 0.9
# What finer plates change in two runs, of which the second shows it three times as much.
CHANGES = [size * np.stack([np.cos(np.arange(50.0)), np.sin(np.arange(50.0))]) for size in (1, 3)]


def driven(plate_share: float, number: int, ratio: float) -> PreparedRun:
    """A run of a driven carriage, recorded with plates of this share of the model's length."""
    setup = setup_of((TIME, OMEGA), vx=[RADIUS * ratio * omega for omega in OMEGA])
    setup.wheel.plate_size *= plate_share
    return coarse(f"run {number}", recorded(setup, number, channels=CHANNELS, force_noise=0.01))


def as_much_as_it_misses(dataset, log_zeta, pool, settings) -> list[np.ndarray]:
    """Stands for finer plates: by run, what the reference model misses."""
    model = AugmentedModel()
    return [
        dataset.prediction(model, run, log_zeta[run], np.zeros(0)) - dataset.recording(run)
        for run in dataset.run_numbers
    ]


def left_of(share: float, channels: tuple[str, ...]) -> list[np.ndarray]:
    """Residuals beside plates, of two runs that are missed by a share of what plates change."""
    bench: Any = SimpleNamespace(channels=channels)
    return beside_plates(bench, [share * each for each in CHANGES], CHANGES)


@pytest.mark.parametrize(("share", "left"), [(-0.7, 0.0), (0.4, 0.4), (-2.5, -0.5)])
def test_one_share_of_what_plates_change_is_taken_off_the_forces_of_all_runs(share, left):
    """No less than nothing, and no more than takes all plates away."""
    for each, change in zip(left_of(share, ("z", "fx")), CHANGES, strict=True):
        assert each[0] == pytest.approx(share * change[0])
        # Rounding of sums of fifty numbers.
        assert each[1] == pytest.approx(left * change[1], abs=1e-12)


def test_nothing_is_taken_off_without_forces_nor_for_a_run_off_the_sand():
    for each, change in zip(left_of(-0.7, ("x", "z")), CHANGES, strict=True):
        assert np.array_equal(each, -0.7 * change)
    lost = [CHANGES[0], np.full_like(CHANGES[1], np.nan)]
    bench: Any = SimpleNamespace(channels=("z", "fx"))
    first, second = beside_plates(bench, [-0.7 * each for each in CHANGES], lost)
    assert first[1] == pytest.approx(np.zeros(50), abs=1e-12)
    assert np.array_equal(second, -0.7 * CHANGES[1])


def test_plates_that_come_to_bear_later_are_no_delay_of_the_instruments():
    """Recorded with plates a third as long; what a delay gains in the forces is their share."""
    ratios = enumerate((0.5, 0.9, 1.3))
    dataset = RigDataset.of([driven(1 / 3, number, ratio) for number, ratio in ratios])
    effects = [effect_class("channel_delay"), effect_class("surface_slope")]
    found = diagnose(dataset, effects, settings=WITHOUT_NEXT_RUN)
    assert found.verdict == ("none",)
    assert found.weights["channel_delay"] < BY_CHANCE


def test_what_plates_change_in_x_and_z_is_nothing_for_unknown_to_explain(monkeypatch):
    """A pull that no offered effect explains, and plates that would change as much as it does."""
    dataset = dataset_with({"name": "drawbar", "force": 6.0})
    effects = [effect_class("measurement_filter")]
    # What the unknown may be is not asked, and so searched for little.
    unknown = UnknownEffectSettings(curves=((6, 10.0),), max_variables=1, refinement_steps=1)
    settings = replace(WITHOUT_NEXT_RUN, unknown_effect=unknown)

    def weight_of_unknown() -> float:
        return diagnose(dataset, effects, settings=settings).weights["unknown"]

    assert weight_of_unknown() > SURE
    monkeypatch.setattr("diagnose.pipeline.changes_with_finer_plates", as_much_as_it_misses)
    assert weight_of_unknown() < 1 - SURE


def test_of_positions_only_x_and_z_count_and_what_is_finite():
    bench: Any = SimpleNamespace(channels=("z", "fx"))
    lost = np.full_like(CHANGES[1], np.nan)
    first, second = of_positions(bench, [CHANGES[0], lost])
    assert np.array_equal(first, [CHANGES[0][0], np.zeros(50)])
    assert not second.any()
