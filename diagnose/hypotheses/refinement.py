r"""Refinement of a hypothesis by simulation: Gauss-Newton steps with Broyden's update.

Each simulation is followed by a linear fit about it. The derivatives J of the residuals r by the
run's log zeta and the coordinates are not computed again: after a step p each run's are corrected
along the way it went,

$$J_+ = J + \frac{(r_+ - r - J p)\,p^T}{p^T p}$$

(Broyden 1965, "A class of methods for solving nonlinear simultaneous equations", Math. Comp. 19),
so that a few simulations settle a hypothesis even far from the null. p is in the units of
`RefinementSettings`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import (
    Hypothesis,
    coordinate_bounds,
    gaussian_prior,
    least_changes,
)
from diagnose.linear.bed import zeta_variance
from diagnose.linear.information import information_on
from diagnose.linear.linear_fit import (
    DEFAULT_LINEAR_FIT,
    GramMatrices,
    LinearFit,
    LinearFitSettings,
    fit_linear,
    floor_inflation,
    log_score,
)
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import (
    directions_within,
    predict,
)
from diagnose.run_pool import RunPool


@dataclass(frozen=True)
class RefinementSettings:
    """Numbers by which a hypothesis is refined.

    Attributes:
        zeta_unit: One unit of log zeta in Broyden's update [-], which corrects each derivative by
            the share of the step that its coordinate made; a strength's is its typical size.
        shape_unit: One unit of the logarithm of a shape there [-].
        floor_shares: In the first fits every model error is raised to this share of the worst
            block's RMS in model errors [-], so that the blocks that are missed by most lead.
        min_step_share: A step that gains nothing is halved until it is below this share of the
            proposed one [-].
        min_gain: Refinement ends where a simulation gains less log score [-].
        min_detour: A simulation that gains nothing is gone on from, once for each best and with
            derivatives computed there, where the step changed a run's log zeta by more than this
            [-]. A change of the load, say, by which the zetas of all runs agree moves them far, and
            the responses with them; no shorter step gains.
    """

    zeta_unit: float = 0.02
    shape_unit: float = 0.3
    floor_shares: tuple[float, ...] = (0.3, 0.1, 0.03)
    min_step_share: float = 0.1
    min_gain: float = 0.5
    min_detour: float = 0.05


DEFAULT_REFINEMENT = RefinementSettings()


def refine(
    regressors: Regressors,
    start: Hypothesis,
    max_simulations: int,
    pool: RunPool,
    settings: RefinementSettings = DEFAULT_REFINEMENT,
) -> Hypothesis:
    """Refine a hypothesis by simulations, each followed by a linear fit; return the best of them.

    A hypothesis whose first simulations fail stays as it was proposed.

    Args:
        regressors: The runs.
        start: Simulated already, or with a proposed step.
        max_simulations: Simulations of all runs at most.
        pool: Threads.
        settings: Numbers of the refinement.
    """
    regressors.dataset.compile(pool, predict, start.model)
    here, best = start, start if start.is_simulated else None
    if start.proposed_step is None:
        zeta, coordinates = _proposal(regressors, start, 0.0, pool)
    else:
        zeta = start.log_zeta + start.proposed_step[0]
        coordinates = start.coordinates + start.proposed_step[1]
    step_share, is_detour = 1.0, False
    for turn in range(max_simulations):
        bounds = coordinate_bounds(here, "least"), coordinate_bounds(here, "most")
        inside = np.clip(coordinates, *bounds)
        moved = _simulate_with_update(regressors, here, zeta, inside, pool, settings)
        leading = not start.is_simulated and turn < len(settings.floor_shares)
        floor_share = settings.floor_shares[turn] if leading else 0.0
        before = -np.inf if best is None else best.score
        if moved is not None and moved.score > before:
            best = moved
        if moved is None:
            step_share /= 4
        elif leading or moved.score > before:
            here, step_share, is_detour = moved, 1.0, False
            if not leading and moved.score - before < settings.min_gain:
                break
        elif not is_detour and np.abs(moved.log_zeta - here.log_zeta).max() > settings.min_detour:
            here, is_detour = relinearize(regressors, moved, pool), True
        else:
            # Not so far; but the simulation there has corrected the derivatives.
            here = replace(best or here, columns=moved.columns)
            step_share /= 2
            if step_share < settings.min_step_share:
                break
        far_zeta, far = _proposal(regressors, here, floor_share, pool)
        zeta = here.log_zeta + step_share * (far_zeta - here.log_zeta)
        coordinates = here.coordinates + step_share * (far - here.coordinates)
    return start if best is None else best


def relinearize(regressors: Regressors, here: Hypothesis, pool: RunPool) -> Hypothesis:
    """The hypothesis with derivatives by the simulator itself, in forward mode, at its numbers."""
    whole = regressors.model_to_differentiate(here.model.effects)
    directions = directions_within(here.model, whole)
    columns = regressors.dataset.derivatives(pool, directions, here.log_zeta, here.coordinates)
    return replace(here, columns=columns)


def at_its_start(regressors: Regressors, start: Hypothesis, pool: RunPool) -> Hypothesis:
    """A hypothesis with a `start_score` where it starts, without its proposed step."""
    at = start.log_zeta, start.coordinates, start.residual
    fit = simulated_fit(regressors, start, *at, pool)
    return replace(start, fit=fit, is_simulated=True, proposed_step=None)


def gauss_newton_step(
    here: Hypothesis,
    matrices: GramMatrices,
    inflation: float = 1.0,
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> tuple[np.ndarray, np.ndarray]:
    """Step that a linear fit about a hypothesis proposes.

    Args:
        here: The hypothesis.
        matrices: Gram matrices of its columns and residuals, of the runs that count.
        inflation: See `fit_linear`.
        settings: Weights of the fit, and the longest step.

    Returns:
        Change of the runs' log zeta [-], shape (runs,), and of the coordinates, shape (free,).
    """
    fit = _fit_about(here, matrices, inflation, settings)
    return _shortened(here, fit.log_zeta_change, fit.coefficients, settings)


@dataclass(frozen=True, eq=False)
class HeldOutCondition:
    """A condition, and a hypothesis's numbers by the runs of the others.

    Attributes:
        runs: Numbers of its runs.
        change: Of the coordinates that were fitted to all runs, shape (free,).
        cost: Log probability that it costs the others to take those of all runs instead [-].
    """

    runs: tuple[int, ...]
    change: np.ndarray
    cost: float


def without_conditions(
    here: Hypothesis,
    matrices: GramMatrices,
    conditions: Sequence[Sequence[int]],
    settings: LinearFitSettings = DEFAULT_LINEAR_FIT,
) -> list[HeldOutCondition]:
    r"""A hypothesis's numbers with each condition left out.

    Their change is what linear fits to the others and to all runs propose differently: a step that
    both propose was not worth making, and says nothing of the runs left out. Where nothing was
    simulated, no step was made yet, and that of the others is all there is.

    Runs that hardly determine a number change it far, and yet say little against the value that all
    runs give it. With the information $A$ of the others, and $A_+$ of all runs, were these missed
    as the others are, a change $\delta$ costs $\tfrac12 (\delta^T A \delta + \ln|A_+| - \ln|A|)$.
    By so much the evidence of the runs left out is less than that of the fit to them (Laplace's
    approximation).

    Args:
        here: The hypothesis, fitted to all runs.
        matrices: Gram matrices of its columns and residuals.
        conditions: Numbers of the runs of each; some runs have another.
        settings: Weights of the fit, and the longest step.
    """
    every = _fit_about(here, matrices, 1.0, settings)
    found = []
    for runs in conditions:
        kept = np.setdiff1d(np.arange(len(here.log_zeta)), runs)
        others = matrices.of_runs(kept)
        if not here.is_simulated:
            change = gauss_newton_step(here, others, settings=settings)[1]
            found.append(HeldOutCondition(tuple(runs), change, np.inf))
            continue
        fit = _fit_about(here, others, 1.0, settings)
        zeta = fit.log_zeta_change - every.log_zeta_change[kept]
        change = _shortened(here, zeta, fit.coefficients - every.coefficients, settings)[1]
        change = np.maximum(change, least_changes(here))
        known, more = (_information(here, each, fit, settings) for each in (others, matrices))
        cost = 0.5 * (float(change @ known @ change) + _log_det(more) - _log_det(known))
        found.append(HeldOutCondition(tuple(runs), change, cost))
    return found


def _log_det(matrix: np.ndarray) -> float:
    return float(np.linalg.slogdet(matrix)[1])


def _information(
    here: Hypothesis, matrices: GramMatrices, fit: LinearFit, settings: LinearFitSettings
) -> np.ndarray:
    """Information that some runs give on a hypothesis's coordinates, shape (free, free)."""
    width, _ = gaussian_prior(here.model, settings)
    return information_on(matrices, fit, width, settings.worth(matrices.blocks), settings)


def _shortened(
    here: Hypothesis, log_zeta: np.ndarray, coordinates: np.ndarray, settings: LinearFitSettings
) -> tuple[np.ndarray, np.ndarray]:
    """A step with no logarithm further than a linear response is trusted."""
    logarithmic = np.array([f.scale is None for f in here.model.free], bool)
    # The whole step is shortened, or the numbers that belong together would part.
    longest = np.abs(np.r_[log_zeta, coordinates[logarithmic]]).max(initial=0.0)
    part = min(1.0, settings.max_log_step / max(longest, 1e-12))
    return part * log_zeta, part * coordinates


def predicted_score(regressors: Regressors, here: Hypothesis, pool: RunPool) -> float:
    """Log score that a linear fit about a hypothesis predicts; its own where that is higher."""
    matrices = _gram_matrices(regressors, here, pool)
    return max(here.score, _fit_about(here, matrices, 1.0, regressors.settings).score)


def _gram_matrices(regressors: Regressors, here: Hypothesis, pool: RunPool) -> GramMatrices:
    return regressors.gram_matrices_of(here.columns, here.residual, here.log_zeta, pool)


def _fit_about(
    here: Hypothesis, matrices: GramMatrices, inflation: float, settings: LinearFitSettings
) -> LinearFit:
    """Linear fit of all coordinates' changes about a hypothesis."""
    width, centre = gaussian_prior(here.model, settings)
    return fit_linear(
        matrices,
        range(len(here.coordinates)),
        prior=width,
        offset=here.coordinates - centre,
        lower=least_changes(here),
        linear_error=settings.corrected_error if here.is_simulated else settings.linear_error,
        inflation=inflation,
        settings=settings,
    )


def _proposal(
    regressors: Regressors, here: Hypothesis, floor_share: float, pool: RunPool
) -> tuple[np.ndarray, np.ndarray]:
    """Log zeta of the runs and coordinates that a linear fit about a hypothesis proposes."""
    matrices, settings = _gram_matrices(regressors, here, pool), regressors.settings
    inflation = floor_inflation(matrices.blocks, here.fit.mean_square, floor_share, settings)
    zeta, change = gauss_newton_step(here, matrices, inflation, settings)
    return here.log_zeta + zeta, here.coordinates + change


def _simulate_with_update(
    regressors: Regressors,
    before: Hypothesis,
    log_zeta: np.ndarray,
    coordinates: np.ndarray,
    pool: RunPool,
    settings: RefinementSettings,
) -> Hypothesis | None:
    """The hypothesis simulated at other numbers, its derivatives corrected by Broyden's update.

    Returns:
        None where a run cannot be simulated.
    """
    dataset = regressors.dataset
    units = np.array(
        [1.0 if f.scale is not None else settings.shape_unit for f in before.model.free]
    )
    change = (coordinates - before.coordinates) / units
    all_units = np.concatenate([[settings.zeta_unit], units])

    def of(run: int) -> tuple[np.ndarray, np.ndarray]:
        predicted = dataset.prediction(before.model, run, log_zeta[run], coordinates)
        residual = predicted - dataset.recording(run)
        own = (log_zeta[run] - before.log_zeta[run]) / settings.zeta_unit
        step = np.concatenate([[own], change])
        change_of_residual = residual - before.residual[run]
        scaled = broyden_update(before.columns[run] * all_units, step, change_of_residual)
        return scaled / all_units, residual

    both = dataset.map(pool, of)
    columns, residual = [c for c, _ in both], [r for _, r in both]
    if not dataset.all_finite(residual):
        return None
    fit = simulated_fit(regressors, before, log_zeta, coordinates, residual, pool)
    return Hypothesis(
        before.model, log_zeta, coordinates, fit, columns, residual, is_simulated=True
    )


def broyden_update(jacobian: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Jacobian, shape (channels, samples, n), corrected by a change of the residual over a step."""
    size = step @ step
    if size == 0:
        return jacobian
    surprise = change - jacobian @ step
    return jacobian + surprise[:, :, None] * step / size


def simulated_fit(
    regressors: Regressors,
    before: Hypothesis,
    log_zeta: np.ndarray,
    coordinates: np.ndarray,
    residual: list[np.ndarray],
    pool: RunPool,
) -> LinearFit:
    """Score of simulated residuals, in the place of a linear fit's."""
    moved = log_zeta + regressors.log_reference_zeta
    mean_square = regressors.block_powers(residual, pool).sum(axis=0)
    variance = zeta_variance(moved)
    matrices, runs, settings = regressors.gram_matrices, len(moved), regressors.settings
    count = matrices.sample_count.sum(axis=0)
    score = log_score(matrices.blocks, count, mean_square, variance, runs, settings=settings)
    return LinearFit(score, coordinates, log_zeta - before.log_zeta, mean_square, variance)
