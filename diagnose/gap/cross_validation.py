"""Cross-validation of effects by condition: each condition predicted from the runs of the others.

All runs of one command and load are held out together. The effect's numbers move from the fit to
all runs by what Gauss-Newton steps of the other runs and of all propose differently, rather than by
a new fit, and the held-out runs are simulated with these. Two things are not cross-validated: the
choice of effects to try, which was made on all runs, and each run's own zeta, which is fitted to
it, as sand is never prepared twice alike and no effect can predict it.
"""

from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.zeta_matching import MatchedRun, match_zeta
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.refinement import HeldOutCondition, without_conditions
from diagnose.linear.linear_fit import GramMatrices, LinearFitSettings, fit_linear
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool
from drftjax.recorded.matched_zeta import DEFAULT_ZETA_MATCH, ZetaMatchSettings
from drftjax.recorded.repeats import group_by_condition

# Longest change of log zeta [-] whose response is taken as linear and not simulated: it moves the
# wheel by 0.2 mm, and the response's curvature is a hundredth of that.
MAX_LINEAR_STEP = 0.01


@dataclass(frozen=True, eq=False)
class RunsByAll:
    """Runs with the numbers of all runs, each at the zeta that fits it best alone.

    Attributes:
        log_zeta: Each run's own log zeta over its set-up's [-], shape (runs,).
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
    """

    log_zeta: np.ndarray
    residual: list[np.ndarray]


@dataclass(frozen=True, eq=False)
class HeldOutPrediction:
    """Runs predicted from numbers fitted without their condition.

    Attributes:
        dataset: The runs, as they were simulated.
        hypothesis: The effects, fitted to all runs.
        log_zeta: Each run's own log zeta over its set-up's [-], shape (runs,).
        coordinates: The effects' free numbers without each run's condition, shape (runs, numbers).
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
        conditions: Those that were held out.
        by_all: The same runs with the numbers of all; where nothing was held out, no others.
    """

    dataset: RigDataset
    hypothesis: Hypothesis
    log_zeta: np.ndarray
    coordinates: np.ndarray
    residual: list[np.ndarray]
    conditions: tuple[HeldOutCondition, ...] = ()
    by_all: RunsByAll | None = None


def predict_held_out(
    regressors: Regressors, hypothesis: Hypothesis, pool: RunPool
) -> HeldOutPrediction:
    r"""Predict every condition with numbers fitted to the runs of the others.

    With all runs' numbers $\theta$, the numbers without a condition are
    $\theta - H_{-c}^{-1} g_{-c} + H^{-1} g$, with the gradient g and the curvature H of the other
    runs and of all. Where $\theta$ suits all runs best, $H^{-1} g$ is zero; elsewhere it is a step
    that simulations did not confirm. Each of the condition's runs then takes the zeta that fits it
    best there.

    Args:
        regressors: Of the dataset.
        hypothesis: Effects with numbers fitted to all runs.
        pool: Threads.

    Returns:
        Runs of a dataset with one condition only as they were fitted.
    """
    log_zeta = np.array(hypothesis.log_zeta)
    coordinates = np.tile(hypothesis.coordinates, (len(log_zeta), 1))
    dataset = regressors.dataset
    if len(hypothesis.coordinates) == 0:
        return HeldOutPrediction(dataset, hypothesis, log_zeta, coordinates, hypothesis.residual)
    products = regressors.gram_matrices_of(
        hypothesis.columns, hypothesis.residual, hypothesis.log_zeta, pool
    )
    groups = [g for g in group_by_condition(dataset.runs) if len(g) < len(log_zeta)]
    conditions = without_conditions(hypothesis, products, groups, regressors.settings)
    for each in conditions:
        for run in each.runs:
            log_zeta[run] += _own_zeta_step(products, run, each.change, regressors.settings)
            coordinates[run] += each.change
    held_out = {run for each in conditions for run in each.runs}

    none = np.zeros(len(hypothesis.coordinates))
    own_step = [_own_zeta_step(products, run, none, regressors.settings) for run in held_out]
    by_all = np.array(hypothesis.log_zeta)
    by_all[list(held_out)] += own_step

    def simulated(run: int, zeta: float, at: np.ndarray) -> np.ndarray:
        return dataset.prediction(hypothesis.model, run, zeta, at) - dataset.recording(run)

    def residual_of(run: int) -> np.ndarray:
        if run not in held_out:
            return hypothesis.residual[run]
        return simulated(run, log_zeta[run], coordinates[run])

    def residual_by_all(run: int) -> np.ndarray:
        step = by_all[run] - hypothesis.log_zeta[run]
        linear = hypothesis.residual[run] + step * hypothesis.by_zeta(run)
        if abs(step) <= MAX_LINEAR_STEP:
            return linear
        found = simulated(run, by_all[run], hypothesis.coordinates)
        return found if np.isfinite(found[np.isfinite(linear)]).all() else linear

    return HeldOutPrediction(
        dataset,
        hypothesis,
        log_zeta,
        coordinates,
        dataset.map(pool, residual_of),
        tuple(conditions),
        RunsByAll(by_all, dataset.map(pool, residual_by_all)),
    )


def at_mean_sinkage(
    prediction: HeldOutPrediction,
    pool: RunPool,
    settings: ZetaMatchSettings = DEFAULT_ZETA_MATCH,
) -> list[MatchedRun]:
    """Every run of a held-out prediction at its matched zeta.

    A run whose mean sinkage is matched by no zeta stays as it is.

    Args:
        prediction: Runs predicted without their condition.
        pool: Threads.
        settings: Numbers of the secant search.
    """
    hypothesis, dataset = prediction.hypothesis, prediction.dataset
    z = dataset.channels.index("z")

    def of(run: int) -> MatchedRun:
        residual = prediction.residual[run]
        near = abs(float(residual[z].mean())) < settings.max_miss
        start = MatchedRun(residual, prediction.log_zeta[run], matched=near)
        slope = hypothesis.by_zeta(run)[z].mean()
        if not slope > 0:
            return start
        coordinates = prediction.coordinates[run]
        found = match_zeta(dataset, hypothesis.model, run, coordinates, start, slope, settings)
        return found if found.matched else start

    return dataset.map(pool, of)


def _own_zeta_step(
    products: GramMatrices, run: int, move: np.ndarray, settings: LinearFitSettings
) -> float:
    """Change of one run's log zeta that fits it best once the effects' numbers have moved.

    The numbers stay: their columns are added to the data, and a fit of zeta alone remains.

    Args:
        products: Products of (log zeta, numbers, data) columns by run and block.
        run: Index of the run.
        move: Change of the numbers, shape (numbers,).
        settings: Weights of the fit.
    """
    gram = products.gram[run]
    moved = gram[:, :, -1] + gram[:, :, 1:-1] @ move
    fixed = np.zeros((len(gram), 2, 2))
    fixed[:, 0, 0] = gram[:, 0, 0]
    fixed[:, 0, 1] = fixed[:, 1, 0] = moved[:, 0]
    fixed[:, 1, 1] = moved[:, -1] + moved[:, 1:-1] @ move
    zeta_only = GramMatrices(
        products.blocks,
        fixed[None],
        products.sample_count[run][None],
        products.log_zeta[run][None],
    )
    return float(fit_linear(zeta_only, [], settings=settings).log_zeta_change[0])
