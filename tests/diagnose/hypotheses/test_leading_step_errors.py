"""What is weighed is simulated as in short steps, at the price of long ones."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta, step_errors, without_step_errors
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.leading_step_errors import without_leading_step_errors
from diagnose.hypotheses.refinement import refine
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import predict
from diagnose.settings import DEFAULT_SETTINGS
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import dataset_with

# Of the error that the leading effect has with the reference model's taken off: what is left of an
# extrapolation from a quarter and a half of the step is of second order.
LEFT = 0.5
# Of metres: another order of sums.
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def pulled(pool) -> RigDataset:
    """Of runs with a drawbar, in steps of up to a fifth of a degree."""
    short = dataset_with({"name": "drawbar", "force": 6.0})
    runs = [
        replace(each, trial=eqx.tree_at(lambda t: t.parts, each.trial, jnp.asarray(1)))
        for each in short.runs
    ]
    return without_step_errors(RigDataset.of(runs), pool)


@pytest.fixture(scope="module")
def screened(pulled, pool) -> ScreeningResult:
    linearized = linearize_runs(pulled, match_initial_zeta(pulled, pool), pool)
    regressors = Regressors.of(pulled, linearized, [effect_class("drawbar")], pool)
    none = refine(regressors, linear_start(regressors, []), 3, pool)
    leading = refine(regressors, linear_start(regressors, regressors.variants), 4, pool)
    return ScreeningResult(regressors, none, (leading,), ())


def miss(dataset: RigDataset, each: Hypothesis, run: int) -> np.ndarray:
    """What a dataset's simulation of a run is wrong by, beside one in a sixteenth of its steps."""
    runs = [
        replace(
            known,
            trial=eqx.tree_at(lambda t: t.parts, known.trial, 16 * known.trial.parts),
            observation=replace(known.observation, step_error=None),
        )
        for known in dataset.runs
    ]
    at = each.model, run, each.log_zeta[run], each.coordinates
    return dataset.prediction(*at) - RigDataset.of(runs).prediction(*at)


def test_the_leading_effect_is_simulated_as_in_short_steps(pulled, screened, pool):
    best = screened.singles[0]
    regressors, by_size = without_leading_step_errors(screened.regressors, screened.by_size, pool)
    dataset = regressors.dataset
    for run in pulled.run_numbers:
        before, after = (np.sqrt(np.mean(miss(d, best, run) ** 2)) for d in (pulled, dataset))
        assert after < LEFT * before
        # What is known of it is what the dataset simulates at its numbers.
        at = best.model, run, best.log_zeta[run], best.coordinates
        simulated = dataset.prediction(*at) - dataset.recording(run)
        np.testing.assert_allclose(by_size[0][0].residual[run], simulated, atol=ROUNDING)


def test_what_an_effect_changes_is_the_same_beside_another_error(screened, pool):
    regressors, by_size = without_leading_step_errors(screened.regressors, screened.by_size, pool)
    before = screened.singles[0].residual[0] - screened.regressors.residual[0]
    after = by_size[0][0].residual[0] - regressors.residual[0]
    np.testing.assert_allclose(after, before, atol=ROUNDING)


def test_a_run_that_diverges_in_shorter_steps_keeps_the_error_that_is_known(
    pulled, screened, pool, monkeypatch
):
    def diverging(model, channels, trial, *at):
        found = predict(model, channels, trial, *at)
        return found if int(trial.parts) == 1 else np.full_like(found, np.nan)

    monkeypatch.setattr("diagnose.dataset.predict", diverging)
    best = screened.singles[0]
    found = step_errors(pulled, best.model, best.log_zeta, best.coordinates, pool)
    for run, error in zip(pulled.runs, found, strict=True):
        assert np.any(error)
        np.testing.assert_array_equal(error, run.observation.step_error)


def test_a_run_that_drops_in_short_steps_alone_keeps_the_error_that_is_known(
    pulled, screened, pool, monkeypatch
):
    of_first = screened.singles[0].log_zeta[0]

    def dropping(model, channels, trial, observed, log_zeta, *at):
        found = predict(model, channels, trial, observed, log_zeta, *at)
        if int(trial.parts) == 1 or float(log_zeta) != of_first:
            return found
        drop = np.where(np.arange(found.shape[1]) < found.shape[1] // 4, 1e-3, 0.0)
        return found - drop * (np.arange(len(found)) == channels.index("z"))[:, None]

    monkeypatch.setattr("diagnose.dataset.predict", dropping)
    regressors, by_size = without_leading_step_errors(screened.regressors, screened.by_size, pool)
    known, found = pulled.observations, regressors.dataset.observations
    np.testing.assert_array_equal(found[0].step_error, known[0].step_error)
    np.testing.assert_array_equal(by_size[0][0].residual[0], screened.singles[0].residual[0])
    assert not np.array_equal(found[1].step_error, known[1].step_error)


def test_without_a_simulated_effect_nothing_changes(screened, pool):
    nothing = [[replace(screened.singles[0], is_simulated=False)], []]
    regressors, by_size = without_leading_step_errors(screened.regressors, nothing, pool)
    assert (regressors, by_size) == (screened.regressors, nothing)


def test_every_explanation_that_is_weighed_is_simulated_at_the_end():
    weighed = DEFAULT_SETTINGS.held_out.of_sizes([None] * 6)
    assert max(weighed) <= DEFAULT_SETTINGS.screening.max_leading
