"""Settings of a diagnosis: each number is passed down to the step that it is of."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from diagnose.gap.selected_effects import EffectSelectionSettings
from diagnose.hypotheses.refinement import RefinementSettings
from diagnose.hypotheses.screening import screen_effects
from diagnose.hypotheses.settings import ScreeningSettings
from diagnose.linear.linear_fit import LinearFitSettings
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model import linearized_run
from diagnose.pipeline import diagnose
from diagnose.selection.model_weights import UNKNOWN, WeightSettings
from diagnose.selection.verdict import VerdictSettings
from diagnose.settings import DiagnosisSettings, HeldOutSettings
from diagnose.unknown.settings import UnknownEffectSettings
from drftjax.effects.rig import Drawbar
from drftjax.effects.sensor import TravelGain
from drftjax.effects.surface import SurfaceSlope
from tests.helpers.rig_datasets import WITHOUT_NEXT_RUN, dataset_with

EFFECTS = (Drawbar, SurfaceSlope, TravelGain)
# Weights of two hypotheses that were refined twice alike, by sums of a few doubles.
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def sloping():
    return dataset_with({"name": "surface_slope", "slope": 0.02})


def few(**screening) -> ScreeningSettings:
    return ScreeningSettings(min_simulated=1, max_simulated=1, **screening)


def test_so_many_effects_are_simulated_as_the_settings_allow(sloping, pool):
    """Pairs are not looked for, as the floor for them is set out of reach."""
    near = ScreeningSettings(pair_floor=np.inf, far_from_floor=np.inf, far_from_scatter=np.inf)
    found = [
        screen_effects(
            sloping, EFFECTS, pool, settings=replace(near, min_simulated=most, max_simulated=most)
        )
        for most in (1, 2)
    ]
    assert [len(each.singles) for each in found] == [1, 2]
    assert all(each.pairs == () for each in found)
    # Where the reference model is far off, every effect that gains is.
    far = few(pair_floor=np.inf, far_from_floor=0.0)
    assert len(screen_effects(sloping, EFFECTS, pool, settings=far).singles) > 2


def test_numbers_of_a_fit_and_of_its_refinement_reach_them(sloping, pool):
    held = screen_effects(
        sloping,
        EFFECTS,
        pool,
        settings=few(
            pair_floor=np.inf,
            linear_fit=LinearFitSettings(strength_prior=1e-3),
            refinement=RefinementSettings(floor_shares=()),
        ),
    )
    free = screen_effects(sloping, EFFECTS, pool, settings=few(pair_floor=np.inf))
    assert held.singles[0].names == free.singles[0].names == ("surface_slope",)
    # A prior that wide at most holds the slope back; the runs show one of a typical size and more.
    assert 0 < held.singles[0].coordinates[0] < free.singles[0].coordinates[0]


def test_a_weight_and_a_threshold_change_the_verdict(sloping):
    usual = diagnose(sloping, EFFECTS, settings=WITHOUT_NEXT_RUN)
    assert usual.verdict == ("surface_slope",)
    prior = WeightSettings(log_prior_unknown=WeightSettings().log_prior_unknown + 30)
    selection = EffectSelectionSettings(large_gap=np.inf)
    # What the unknown may be is not asked, and so searched for little.
    unknown = UnknownEffectSettings(curves=((6, 10.0),), max_variables=1, refinement_steps=1)
    certain = replace(WITHOUT_NEXT_RUN, weights=prior)
    settings = replace(certain, selection=selection, unknown_effect=unknown)
    believed = diagnose(sloping, EFFECTS, settings=settings)
    assert believed.verdict == (UNKNOWN,)
    # The slope explains nearly all of a large gap, and is named beside what is believed in.
    beside = diagnose(sloping, EFFECTS, settings=certain)
    assert beside.verdict == ("surface_slope",)
    share = VerdictSettings().listed_share
    assert beside.weights["surface_slope"] == pytest.approx(share, abs=0.01)
    cautious = DiagnosisSettings(
        verdict=VerdictSettings(alarm_ratio=1e12, max_competing=0), held_out=HeldOutSettings(1, 0)
    )
    silent = diagnose(sloping, EFFECTS, settings=cautious)
    assert silent.verdict == ("none",)
    assert set(silent.weights) == {"none", "surface_slope", UNKNOWN}
    # The weights are no part of that rule: the effect stays as probable as before.
    odds = [
        np.log(found.weights["surface_slope"] / found.weights["none"]) for found in (usual, silent)
    ]
    assert odds[0] == pytest.approx(odds[1], rel=ROUNDING)


def test_every_run_is_linearised_once_for_the_effects(sloping, pool, monkeypatch):
    linearized, linearize = [], linearized_run.linearize

    def counted(trial, steps, nodes, size):
        linearized.append(nodes)
        return linearize(trial, steps, nodes, size)

    monkeypatch.setattr("diagnose.linear.linearized_runs.linearize", counted)
    runs = linearize_runs(sloping, np.zeros(len(sloping.runs)), pool)
    Regressors.of(sloping, runs, EFFECTS, pool)
    Regressors.of(sloping, runs, EFFECTS[:1], pool)
    assert len(linearized) == len(sloping.runs)


def test_every_settings_object_is_frozen_and_documented():
    def objects(settings):
        yield type(settings)
        for each in dataclasses.fields(settings):
            value = getattr(settings, each.name)
            if dataclasses.is_dataclass(value):
                yield from objects(value)

    for each in objects(DiagnosisSettings()):
        assert each.__dataclass_params__.frozen
        for field in dataclasses.fields(each):
            assert f"{field.name}" in each.__doc__, f"{each.__name__}.{field.name}"
