"""Prediction of runs left out by condition: does an effect found on some runs help on others?

All runs of one command and load are left out together, the effect's numbers move to where the
others alone would have them, and the left-out runs are simulated with these. The move is one
straight-line step from the numbers fitted to all runs, not a search anew; which effects are tried
was chosen on all runs too. Each run's own zeta stays its own and is fitted to it: sand is never the
same twice, and no effect can know it.
"""

from dataclasses import dataclass

import numpy as np

from diagnose.gap.zeta_matching import MET, MatchedRun, match_zeta
from diagnose.hypotheses.hypothesis import Hypothesis, gauss_newton_step
from diagnose.linear.linear_fit import GramMatrices, fit_linear
from diagnose.linear.regressors import Regressors
from drftjax.recorded.repeats import group_by_condition


@dataclass(frozen=True, eq=False)
class HeldOutPrediction:
    """Runs predicted from numbers fitted without their condition.

    Attributes:
        hypothesis: The effects, fitted to all runs.
        log_zeta: Each run's own log zeta over its set-up's, shape (runs,).
        coordinates: The effects' free numbers without each run's condition, shape (runs, numbers).
        residual: By run, simulated less recorded, shape (channels, samples).
    """

    hypothesis: Hypothesis
    log_zeta: np.ndarray
    coordinates: np.ndarray
    residual: list[np.ndarray]


def predict_held_out(bench: Regressors, hypothesis: Hypothesis) -> HeldOutPrediction:
    """Each run simulated with numbers fitted without its condition."""
    log_zeta = np.array(hypothesis.log_zeta)
    coordinates = np.tile(hypothesis.coordinates, (len(log_zeta), 1))
    if len(hypothesis.coordinates) == 0:
        return HeldOutPrediction(hypothesis, log_zeta, coordinates, hypothesis.residual)
    products = bench.gram_matrices_of(hypothesis.columns, hypothesis.residual, hypothesis.log_zeta)
    left_out: set[int] = set()
    case = bench.dataset
    for group in group_by_condition(case.runs):
        kept = np.setdiff1d(np.arange(len(log_zeta)), group)
        if kept.size == 0:
            continue
        _, move = gauss_newton_step(hypothesis, _of_runs(products, kept))
        for run in group:
            log_zeta[run] += _own_zeta(products, run, move)
            coordinates[run] += move
        left_out.update(group)

    def of(run: int) -> np.ndarray:
        if run not in left_out:
            return hypothesis.residual[run]
        model, at = hypothesis.model, coordinates[run]
        return case.prediction(model, run, log_zeta[run], at) - case.recording(run)

    return HeldOutPrediction(hypothesis, log_zeta, coordinates, case.map_runs(of))


def at_mean_sinkage(bench: Regressors, unseen: HeldOutPrediction) -> list[MatchedRun]:
    """Every run where its own zeta meets its mean sinkage.

    A run whose mean sinkage no step of zeta leads to stays as it is.
    """
    here, z = unseen.hypothesis, bench.dataset.channels.index("z")

    def of(run: int) -> MatchedRun:
        residual = unseen.residual[run]
        near = abs(float(residual[z].mean())) < MET
        start = MatchedRun(residual, unseen.log_zeta[run], matched=near)
        slope = here.by_zeta(run)[z].mean()
        if not slope > 0:
            return start
        found = match_zeta(bench.dataset, here.model, run, unseen.coordinates[run], start, slope)
        return found if found.matched else start

    return bench.dataset.map_runs(of)


def _of_runs(products: GramMatrices, runs: np.ndarray) -> GramMatrices:
    return GramMatrices(
        products.blocks, products.gram[runs], products.sample_count[runs], products.log_zeta[runs]
    )


def _own_zeta(products: GramMatrices, run: int, move: np.ndarray) -> float:
    """Change of one run's log zeta that suits these numbers best."""
    gram = products.gram[run]
    moved = gram[:, :, -1] + gram[:, :, 1:-1] @ move
    fixed = np.zeros((len(gram), 2, 2))
    fixed[:, 0, 0] = gram[:, 0, 0]
    fixed[:, 0, 1] = fixed[:, 1, 0] = moved[:, 0]
    fixed[:, 1, 1] = moved[:, -1] + moved[:, 1:-1] @ move
    alone = GramMatrices(
        products.blocks,
        fixed[None],
        products.sample_count[run][None],
        products.log_zeta[run][None],
    )
    return float(fit_linear(alone, []).log_zeta_change[0])
