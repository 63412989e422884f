"""Responses to further effects beside a set, held against differences of whole simulations."""

from dataclasses import replace

import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.hypotheses.exact_responses import (
    SMALL_STRENGTH,
    FurtherResponses,
    exact_responses,
)
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.refinement import refine, relinearize
from diagnose.hypotheses.set_candidates import joined_from_null
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import SLOW_EFFECTS, Regressors
from diagnose.model.augmented_model import AugmentedModel, shared_model
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import dataset_with

# A late reading moves what all other effects do to the runs; loosening has a shape, and
# rate_hardening and cohesion are not in the program that differentiates all sets.
SET = ("measurement_delay", "horizontal_coulomb")
FURTHER = ("sinkage_gain", "loosening", "drawbar", "rate_hardening", "cohesion")
SLOW_BESIDE = [each for each in FURTHER if each in SLOW_EFFECTS]
TRUTH = (
    {"name": "measurement_delay", "delay": 0.15},
    {"name": "horizontal_coulomb", "force": 6.0},
)
# Of a typical size: the difference of two runs is then exact to a thousandth, and well above their
# rounding.
STEP = 1e-3


@pytest.fixture(scope="module")
def regressors(pool) -> Regressors:
    effects = [*map(effect_class, (*SET, *FURTHER))]
    dataset = replace(dataset_with(*TRUTH), shared=shared_model(effects))
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    return Regressors.of(dataset, linearized, effects, pool)


@pytest.fixture(scope="module")
def here(regressors, pool) -> Hypothesis:
    start = linear_start(regressors, [_variant(regressors, name) for name in SET])
    return relinearize(regressors, refine(regressors, start, 3, pool), pool)


def _variant(regressors: Regressors, name: str):
    of_name = [each for each in regressors.variants if each.effect.about.name == name]
    return of_name[len(of_name) // 2]


def _difference(regressors: Regressors, here: Hypothesis, name: str, run: int) -> np.ndarray:
    """Change of a run by one strength more, over its step, shape (channels, samples)."""
    variant = _variant(regressors, name)
    model = AugmentedModel((*here.model.effects, variant.effect))
    behind = [*map(np.log, variant.shapes)]
    either = [
        regressors.dataset.prediction(
            model, run, here.log_zeta[run], np.r_[here.coordinates, sign * STEP, behind]
        )
        for sign in (1.0, -1.0)
    ]
    return (either[0] - either[1]) / (2 * STEP)


@pytest.mark.parametrize("name", [each for each in FURTHER if each not in SLOW_EFFECTS])
def test_responses_beside_a_set_are_those_of_the_simulator(regressors, here, pool, name):
    variants = [_variant(regressors, each) for each in FURTHER]
    found = exact_responses(regressors, here, variants, pool)[name]
    for run, own in enumerate(found):
        expected = _difference(regressors, here, name, run)
        error = np.abs(own[:, :, 0] - expected).max(axis=1)
        # Slopes are taken in whole steps, runs in parts of them: two hundredths of the response.
        assert (error <= 0.02 * np.abs(expected).max()).all()


def test_responses_about_the_reference_model_are_others(regressors, here):
    """Beside a late reading the gain of a height is late, too."""
    column = 1 + _variant(regressors, "sinkage_gain").columns[0]
    expected = _difference(regressors, here, "sinkage_gain", 0)
    error = np.abs(regressors.columns[0][:, :, column] - expected).max()
    assert error > 0.05 * np.abs(expected).max()


@pytest.mark.parametrize("name", SLOW_BESIDE)
def test_what_the_common_program_lacks_is_simulated(regressors, here, pool, name):
    variants = [_variant(regressors, each) for each in FURTHER]
    found = exact_responses(regressors, here, variants, pool)
    assert sorted(found) == sorted(FURTHER)
    for run, own in enumerate(found[name]):
        expected = _difference(regressors, here, name, run)
        error = np.abs(own[:, :, 0] - expected).max(axis=1)
        # A secant over a tenth of its typical size, with zeta's derivative after Broyden's updates.
        assert (error <= 0.05 * np.abs(expected).max()).all()


def test_the_wheel_stays_as_deep_meanwhile(regressors, here, pool, monkeypatch):
    """On sand that gets stronger a wheel that rests would stand for longer."""
    simulated = RigDataset.prediction
    depths = {}

    def watched(self, model, run, log_zeta, coordinates):
        found = simulated(self, model, run, log_zeta, coordinates)
        z = found[self.channels.index("z")].mean()
        depths.setdefault(run, []).append((log_zeta == here.log_zeta[run], z))
        return found

    variant = _variant(regressors, "cohesion")
    monkeypatch.setattr(RigDataset, "prediction", watched)
    found = exact_responses(regressors, here, [variant], pool)["cohesion"]
    z = regressors.dataset.channels.index("z")
    for run, ((_, plain), (is_same_zeta, moved)) in depths.items():
        assert not is_same_zeta
        # What it would rise by with zeta as it is.
        alone = SMALL_STRENGTH * found[run][z, :, 0].mean()
        assert abs(moved - plain) < 0.2 * abs(alone)


def test_responses_that_are_not_known_exactly_are_the_regressors(regressors, here, pool):
    variants = [_variant(regressors, each) for each in FURTHER]
    exact = dict(exact_responses(regressors, here, variants, pool))
    del exact["rate_hardening"]  # as of an effect with which no run can be simulated
    found = FurtherResponses.of(regressors, here, variants, exact)
    place = FURTHER.index("rate_hardening")
    assert [each.columns for each in found.variants] == [(k,) for k in range(len(FURTHER))]
    column = 1 + _variant(regressors, "rate_hardening").columns[0]
    behind = found.columns[0][:, :, -len(FURTHER) :]
    assert (behind[:, :, place] == regressors.columns[0][:, :, column]).all()
    assert (behind[:, :, 0] == exact[FURTHER[0]][0][:, :, 0]).all()


def test_beside_a_set_with_such_an_effect_responses_are_those_of_the_simulator(regressors, pool):
    names = ("measurement_delay", "rate_hardening")
    start = linear_start(regressors, [_variant(regressors, name) for name in names])
    beside = refine(regressors, start, 2, pool)
    # No rate hardening is in these runs: it acts as it would in others.
    beside = replace(beside, coordinates=beside.coordinates + np.eye(len(beside.coordinates))[1])
    variant = _variant(regressors, "sinkage_gain")
    own = exact_responses(regressors, beside, [variant], pool)["sinkage_gain"][0]
    expected = _difference(regressors, beside, "sinkage_gain", 0)
    error = np.abs(own[:, :, 0] - expected).max(axis=1)
    assert (error <= 0.02 * np.abs(expected).max()).all()


def test_an_effect_joins_with_its_exact_response(regressors, here, pool):
    variant = _variant(regressors, "loosening")
    exact = exact_responses(regressors, here, [variant], pool)["loosening"]
    count = len(here.coordinates)
    fit = linear_start(regressors, [variant]).fit
    both = np.r_[np.zeros(count), fit.coefficients]
    joined = joined_from_null(regressors, here, [variant], replace(fit, coefficients=both), exact)
    assert joined.names == (*here.names, "loosening")
    assert (joined.columns[0][:, :, 1 + count] == exact[0][:, :, 0]).all()
    assert joined.columns[0].shape[2] == 1 + len(joined.coordinates)
