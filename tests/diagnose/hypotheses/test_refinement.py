"""Refinement by simulation: detours, and numbers without some of the runs."""

from dataclasses import replace

import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.hypotheses import refinement
from diagnose.hypotheses.hypothesis import Hypothesis, linear_start
from diagnose.hypotheses.refinement import (
    RefinementSettings,
    gauss_newton_step,
    refine,
    without_conditions,
)
from diagnose.linear.linear_fit import (
    DEFAULT_LINEAR_FIT,
    WITHOUT_LEVELS,
    LinearFitSettings,
    fit_linear,
)
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import WITH_REST, dataset_with

FAR = RefinementSettings().min_detour
# A linear fit about all runs' numbers, over a new fit: the responses change a little on the way.
LINEAR = 0.1
# Far from the optimum the blocks are weighed anew, which moves what is left of the step.
WEIGHED_ANEW = 0.3
# A parabola for the logarithm of a mean square, which it lies above: by 11 % here.
PARABOLA = 0.2


def fitted(
    dataset: RigDataset,
    simulations: int,
    pool: RunPool,
    weights: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> tuple[Regressors, Hypothesis]:
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    regressors = Regressors.of(dataset, linearized, [effect_class("drawbar")], pool, weights)
    begun = linear_start(regressors, regressors.variants)
    return regressors, refine(regressors, begun, simulations, pool)


@pytest.fixture(scope="module")
def pulled() -> RigDataset:
    return dataset_with({"name": "drawbar", "force": 3.0}, settings=WITH_REST)


@pytest.fixture(scope="module")
def start(pulled, pool) -> tuple[Regressors, Hypothesis]:
    return fitted(pulled, 1, pool)


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


# Where levels count the blocks are weighed anew nearer to the optimum: a tenth off, that moves the
# small change by a third.
@pytest.mark.parametrize(("weights", "off"), [(WITHOUT_LEVELS, 0.3), (DEFAULT_LINEAR_FIT, 0.08)])
def test_numbers_without_a_condition_are_those_of_a_fit_without_it(pulled, pool, weights, off):
    """Also where the numbers are off what suits all runs: that is no fault of the condition."""
    regressors, settled = fitted(pulled, 3, pool, weights)
    columns, residual = settled.columns, settled.residual
    away = replace(
        settled,
        coordinates=settled.coordinates + off,
        residual=[r + off * c[:, :, 1] for r, c in zip(residual, columns, strict=True)],
    )
    of_settled, of_away = (
        regressors.gram_matrices_of(each.columns, each.residual, each.log_zeta, pool)
        for each in (settled, away)
    )
    for kept, condition in (([0, 1], [2]), ([2], [0, 1])):
        alone = RigDataset.of([pulled.runs[run] for run in kept], WITH_REST)
        change = fitted(alone, 3, pool, weights)[1].coordinates - settled.coordinates
        (linear,) = without_conditions(settled, of_settled, [condition], weights)
        assert linear.change == pytest.approx(change, rel=LINEAR)
        (linear,) = without_conditions(away, of_away, [condition], weights)
        assert linear.change == pytest.approx(change, rel=WEIGHED_ANEW)
        # One step from there would make up for where it began instead.
        step = gauss_newton_step(away, of_away.of_runs(np.array(kept)), settings=weights)[1]
        assert abs(step[0]) > 0.9 * off > 100 * abs(change[0])


def test_numbers_that_were_never_simulated_are_those_that_the_other_runs_propose(start, pool):
    regressors, _ = start
    proposed = linear_start(regressors, regressors.variants)
    matrices = regressors.gram_matrices_of(
        proposed.columns, proposed.residual, proposed.log_zeta, pool
    )
    kept = np.array([0, 1])
    step = gauss_newton_step(proposed, matrices.of_runs(kept))[1]
    assert abs(step[0]) > 0.1
    (found,) = without_conditions(proposed, matrices, [[2]])
    assert found.change == pytest.approx(step, rel=1e-12)
    # No simulation has confirmed the numbers of all runs, so they are not taken at any cost.
    assert found.cost == np.inf


def test_numbers_of_all_runs_cost_what_the_others_are_less_probable_with_them(pulled, pool):
    """Checked by simulation of the others with either number, each run at its own best zeta."""
    other = dataset_with({"name": "drawbar", "force": 3.2}, settings=WITH_REST).runs[2]
    mixed = RigDataset.of([*pulled.runs[:2], other], WITH_REST)
    regressors, together = fitted(mixed, 3, pool)
    matrices = regressors.gram_matrices_of(
        together.columns, together.residual, together.log_zeta, pool
    )
    (found,) = without_conditions(together, matrices, [[2]])
    alone, own = fitted(RigDataset.of(pulled.runs[:2], WITH_REST), 3, pool)

    def evidence(coordinates: np.ndarray) -> float:
        residual = [
            alone.dataset.prediction(own.model, run, own.log_zeta[run], coordinates)
            - alone.dataset.recording(run)
            for run in range(2)
        ]
        by_zeta = [columns[:, :, :1] for columns in own.columns]
        products = alone.gram_matrices_of(by_zeta, residual, own.log_zeta, pool)
        return fit_linear(products, []).score

    lost = evidence(own.coordinates) - evidence(together.coordinates)
    # Runs that agree cost what the one left out adds to what is known of the number.
    _, settled = fitted(pulled, 3, pool)
    matrices = regressors.gram_matrices_of(
        settled.columns, settled.residual, settled.log_zeta, pool
    )
    (agreed,) = without_conditions(settled, matrices, [[2]])
    assert 0 < agreed.cost < 1
    assert found.cost - agreed.cost == pytest.approx(lost, rel=PARABOLA)
