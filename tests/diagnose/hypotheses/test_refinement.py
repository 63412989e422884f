"""Refinement by simulation: where a step that gains nothing is gone on from."""

from dataclasses import replace

import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses import refinement
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.refinement import RefinementSettings, refine
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import dataset_with

FAR = RefinementSettings().min_detour


@pytest.fixture(scope="module")
def start(pool) -> tuple[Regressors, Hypothesis]:
    dataset = dataset_with({"name": "drawbar", "force": 3.0})
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    regressors = Regressors.of(dataset, linearized, [effect_class("drawbar")], pool)
    return regressors, refine(regressors, linear_start(regressors, regressors.variants), 1, pool)


@pytest.mark.parametrize(("moved_by", "goes_on"), [(0.5 * FAR, 0), (2 * FAR, 1)])
def test_a_step_that_moves_zetas_far_is_gone_on_from_once(
    start, pool, monkeypatch, moved_by, goes_on
):
    """Scores and steps are given, as a simulator would answer: the first two steps gain nothing."""
    regressors, first = start
    begun_at, differentiated = [], []

    def simulated(regressors, before, log_zeta, coordinates, pool, settings):
        begun_at.append(before)
        score = first.score + (5.0 if len(begun_at) > 2 else -5.0)
        fit = replace(before.fit, score=score)
        return replace(before, log_zeta=before.log_zeta + moved_by, fit=fit)

    def differentiate(regressors, here, pool):
        differentiated.append(here)
        return here

    monkeypatch.setattr(refinement, "_simulate_with_update", simulated)
    monkeypatch.setattr(refinement, "relinearize", differentiate)
    found = refine(regressors, first, 3, pool)
    assert len(differentiated) == goes_on
    # By how far zetas are from where each simulation began: at the best, after one step, the best.
    away = [float((each.log_zeta - first.log_zeta).max()) for each in begun_at]
    assert away == pytest.approx([0.0, goes_on * moved_by, 0.0])
    assert found.score == first.score + 5.0
