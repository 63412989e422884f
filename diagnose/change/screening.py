"""Screening of what may have changed: linear fits of all effects, then simulations of a few."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from diagnose.change.differences.fit import (
    CoefficientPrior,
    DifferenceFit,
    score_differences,
)
from diagnose.change.differences.gram import DifferenceGram
from diagnose.change.hypothesis import ChangeHypothesis, ChangeProblem, Side
from diagnose.hypotheses.hypothesis import lower_bounds
from diagnose.hypotheses.refinement import broyden_update
from diagnose.linear.linear_fit import Block
from diagnose.linear.regressors import ShapeVariant
from diagnose.model.augmented_model import AugmentedModel, directions_within, predict
from diagnose.run_pool import RunPool


@dataclass(frozen=True)
class ChangeScreeningSettings:
    """Numbers by which explanations are screened.

    Attributes:
        max_simulated: Effects that are simulated, at most, the best linear fits first.
        min_gain: Log score that a linear fit must gain over no change for it [-].
        hopeless_deficit: Nor is one that is this far behind the best linear fit [-].
        simulations: Simulations of all runs with each, at most; and in each further round.
        floor_shares: In the first fits every model error is raised to this share of the worst
            block's RMS in model errors [-], so that the blocks that are missed by most lead.
        max_continued: Effects that go on, the best first, with derivatives computed at their
            numbers: those from the null, corrected along the way, stop short of a large strength.
        max_rounds: Rounds of these at most.
        min_round_gain: A further round is made while the last one gained this much [-].
        min_step_share: A step that gains nothing is halved down to this share [-].
        min_score_gain: Refinement ends where a simulation gains less [-]: a bin counts for a tenth
            of a statement, so that little of the score is much of an error.
        zeta_unit: One unit of log zeta in Broyden's update [-]; a strength's is its typical size.
        shape_unit: One unit of the logarithm of a shape there [-].
        parameter_cost: Log score that each number costs in the ranking [-].
    """

    max_simulated: int = 8
    min_gain: float = 0.5
    hopeless_deficit: float = 40.0
    simulations: int = 7
    floor_shares: tuple[float, ...] = (0.3, 0.1, 0.03)
    max_continued: int = 3
    max_rounds: int = 3
    min_round_gain: float = 0.5
    min_step_share: float = 0.1
    min_score_gain: float = 0.02
    zeta_unit: float = 0.02
    shape_unit: float = 0.3
    parameter_cost: float = 1.0


DEFAULT_CHANGE_SCREENING = ChangeScreeningSettings()


@dataclass(frozen=True, eq=False)
class ChangeScreening:
    """Explanations of a change.

    Attributes:
        none: No change, each run with its own zeta within the bed's scatter.
        zeta: The sand's strength changed.
        effects: One for each effect, best first; the leading ones simulated.
        blocks: (channel, kind) of each block of the differences.
        worth: Independent statements in each [-], shape (blocks,).
    """

    none: ChangeHypothesis
    zeta: ChangeHypothesis
    effects: tuple[ChangeHypothesis, ...]
    blocks: tuple[Block, ...]
    worth: np.ndarray

    @property
    def all(self) -> tuple[ChangeHypothesis, ...]:
        """No change first, then zeta, then effects."""
        return (self.none, self.zeta, *self.effects)


def screen_change(
    problem: ChangeProblem,
    pool: RunPool,
    settings: ChangeScreeningSettings = DEFAULT_CHANGE_SCREENING,
) -> ChangeScreening:
    """Fit every explanation, and simulate those that lead.

    Args:
        problem: The runs and their responses.
        pool: Threads.
        settings: Numbers of the screening.
    """
    matrices = _linear_responses(problem, pool)
    none, zeta, effects = _linear_fits(problem, matrices, settings)
    least = none.score + settings.min_gain
    leading = [
        each
        for each in effects[: settings.max_simulated]
        if each.score > max(least, effects[0].score - settings.hopeless_deficit)
    ]
    none, zeta, *refined = pool.map_outer(
        lambda each: _refine(problem, each, pool, settings), (none, zeta, *leading)
    )
    refined.sort(key=lambda each: -_ranking(each, settings))
    going_on = refined[: settings.max_continued]
    none, zeta, *going_on = pool.map_outer(
        lambda each: _finish(problem, each, pool, settings), (none, zeta, *going_on)
    )
    # What is not worth a simulation is taken to do no better than no change, which has one.
    unchanged = [replace(each, fit=none.fit) for each in effects[len(leading) :]]
    others = *refined[settings.max_continued :], *unchanged
    ranked = sorted((*going_on, *others), key=lambda each: -_ranking(each, settings))
    worth = matrices.worth(problem.settings)
    return ChangeScreening(none, zeta, tuple(ranked), matrices.blocks, worth)


def _refine(
    problem: ChangeProblem,
    start: ChangeHypothesis,
    pool: RunPool,
    settings: ChangeScreeningSettings,
) -> ChangeHypothesis:
    """Refine a hypothesis by simulations, each followed by a linear fit; return the best.

    One whose simulations all fail stays as it was proposed.

    Args:
        problem: The runs.
        start: Simulated already, or with a proposed step.
        pool: Threads.
        settings: Numbers of the refinement.
    """
    problem.regressors.dataset.compile(pool, predict, start.model)
    here, best = start, start if start.is_simulated else None
    share = 1.0
    coordinates, log_zeta = start.proposed or _proposal(problem, start, share, 0.0, pool)
    for turn in range(settings.simulations):
        moved = _simulate(problem, here, coordinates, log_zeta, pool, settings)
        is_better = moved is not None and (best is None or moved.score > best.score)
        leading = not start.is_simulated and turn < len(settings.floor_shares)
        if moved is None:
            share /= 4
        elif is_better or leading:
            gain = np.inf if best is None else moved.score - best.score
            here, share = moved, 1.0
            best = moved if is_better else best
            if not leading and gain < settings.min_score_gain:
                break
        else:
            # Not so far; but the simulation there has corrected the derivatives.
            here = replace(best or here, columns=moved.columns, by_zeta=moved.by_zeta)
            share /= 2
        if share < settings.min_step_share:
            break
        floor_share = settings.floor_shares[turn] if leading else 0.0
        coordinates, log_zeta = _proposal(problem, here, share, floor_share, pool)
    return start if best is None else best


def _finish(
    problem: ChangeProblem,
    here: ChangeHypothesis,
    pool: RunPool,
    settings: ChangeScreeningSettings,
) -> ChangeHypothesis:
    """Refine a hypothesis with fresh derivatives, round by round, while that gains.

    Args:
        problem: The runs.
        here: The hypothesis; one that was not simulated stays as it is.
        pool: Threads.
        settings: Numbers of the refinement.
    """
    for _ in range(settings.max_rounds if here.is_simulated else 0):
        before = here.score
        here = _refine(problem, _relinearize(problem, here, pool), pool, settings)
        if here.score < before + settings.min_round_gain:
            break
    return here


def _relinearize(problem: ChangeProblem, here: ChangeHypothesis, pool: RunPool) -> ChangeHypothesis:
    """The hypothesis with derivatives by the simulator itself, in forward mode, at its numbers."""
    regressors, acts = problem.regressors, here.acts(problem.differences.is_now)
    directions = directions_within(
        here.model, regressors.model_to_differentiate(here.model.effects)
    )
    there = here.coordinates if here.model.effects else np.zeros(0)
    null = here.start if here.model.effects else np.zeros(0)
    at = np.where(acts[:, None], there, null)
    found = regressors.dataset.derivatives(pool, directions, here.log_zeta, at)
    by_zeta = [each[:, :, 0] for each in found]
    columns = [each[:, :, :1] if here.zeta_changes else each[:, :, 1:] for each in found]
    acting = [each * float(on) for each, on in zip(columns, acts, strict=True)]
    return replace(here, by_zeta=by_zeta, columns=acting)


def _proposal(
    problem: ChangeProblem,
    here: ChangeHypothesis,
    share: float,
    floor_share: float,
    pool: RunPool,
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and log zetas so much of the way to where a linear fit leads."""
    fit = problem.fit_about(here, pool, floor_share)
    step = fit.coefficients
    common = step[-1] * problem.differences.is_now if here.zeta_changes else 0.0
    coordinates = here.coordinates + share * step
    return coordinates, here.log_zeta + share * (fit.zeta_change + common)


def _linear_responses(problem: ChangeProblem, pool: RunPool) -> DifferenceGram:
    """Gram matrices of every effect in the runs of now, a common change of log zeta last."""
    reference, is_now = problem.regressors, problem.differences.is_now
    columns = [
        np.concatenate([each[:, :, 1:], each[:, :, :1]], axis=2) * float(now)
        for each, now in zip(reference.columns, is_now, strict=True)
    ]
    return problem.differences.gram(columns, problem.by_zeta, reference.residual, pool)


def _linear_fits(
    problem: ChangeProblem, matrices: DifferenceGram, settings: ChangeScreeningSettings
) -> tuple[ChangeHypothesis, ChangeHypothesis, list[ChangeHypothesis]]:
    """No change, a change of zeta, and every effect's best form, best effect first."""
    reference = problem.regressors
    share = problem.settings.linear_error

    def fit(
        numbers: tuple[int, ...], prior: CoefficientPrior, side: Side | None = "now"
    ) -> DifferenceFit:
        deviation = problem.deviation_from(side, reference.log_zeta)
        return problem.fit(matrices, numbers, deviation, prior, share)

    nothing = fit((), CoefficientPrior.free(np.zeros(0)), None)
    width = np.array([problem.settings.zeta_prior])
    sand = fit((reference.columns[0].shape[-1] - 1,), CoefficientPrior.free(width))
    best: dict[str, tuple[float, ShapeVariant, Side, DifferenceFit]] = {}
    for variant in reference.variants:
        for side, bounded in _priors(variant, problem.settings.strength_prior):
            found = fit(variant.columns, bounded, side)
            cost = settings.parameter_cost * (len(variant.columns) + len(variant.shapes))
            name = variant.effect.about.name
            if name not in best or found.score - cost > best[name][0]:
                best[name] = found.score - cost, variant, side, found
    ranked = sorted(best.values(), key=lambda each: -each[0])
    return (
        problem.linear_start(None, "now", nothing),
        problem.zeta_start(sand),
        [problem.linear_start(variant, side, found) for _, variant, side, found in ranked],
    )


def _priors(variant: ShapeVariant, width: float) -> Iterator[tuple[Side, CoefficientPrior]]:
    """Sides on which an effect may act, with the bounds of its strengths in the runs of now.

    An effect whose strengths have one sign only may have come, or have gone.
    """
    least = np.array(lower_bounds(variant.effect))
    free = CoefficientPrior.free(np.full(len(least), width))
    yield "now", replace(free, least=least)
    if (least == 0).all():
        yield "before", replace(free, most=-least)


def _ranking(each: ChangeHypothesis, settings: ChangeScreeningSettings) -> float:
    return each.score - settings.parameter_cost * len(each.coordinates)


def _simulate(
    problem: ChangeProblem,
    here: ChangeHypothesis,
    coordinates: np.ndarray,
    log_zeta: np.ndarray,
    pool: RunPool,
    settings: ChangeScreeningSettings,
) -> ChangeHypothesis | None:
    """The hypothesis simulated at other numbers, its derivatives corrected by Broyden's update.

    Returns:
        None where a run cannot be simulated.
    """
    dataset, is_now = problem.regressors.dataset, problem.differences.is_now
    prior = here.coordinate_prior(problem.settings)
    coordinates = here.coordinates + np.clip(
        coordinates - here.coordinates, prior.least, prior.most
    )
    acts = here.acts(is_now)
    if here.zeta_changes:
        units = np.array([settings.zeta_unit])
    else:
        units = np.array([settings.shape_unit if f.scale is None else 1 for f in here.model.free])
    change = coordinates - here.coordinates
    own = log_zeta - here.log_zeta - (change[-1] * is_now if here.zeta_changes else 0.0)

    def of(run: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        on = bool(acts[run]) and bool(here.model.effects)
        model = here.model if on else AugmentedModel()
        at = coordinates if on else np.zeros(0)
        residual = dataset.prediction(model, run, log_zeta[run], at) - dataset.recording(run)
        step = np.r_[own[run] / settings.zeta_unit, change / units * float(acts[run])]
        scale = np.r_[settings.zeta_unit, units]
        jacobian = np.concatenate([here.by_zeta[run][:, :, None], here.columns[run]], axis=2)
        moved = np.nan_to_num(residual - here.residual[run])
        jacobian = broyden_update(jacobian * scale, step, moved) / scale
        return residual, jacobian[:, :, 0], jacobian[:, :, 1:] * float(acts[run])

    found = dataset.map(pool, of)
    residual = [each[0] for each in found]
    if not dataset.all_finite(residual):
        return None
    moved = replace(
        here,
        coordinates=coordinates,
        log_zeta=log_zeta,
        residual=residual,
        by_zeta=[each[1] for each in found],
        columns=[each[2] for each in found],
        is_simulated=True,
        proposed=None,
    )
    return replace(moved, fit=_score(problem, moved, pool))


def _score(problem: ChangeProblem, here: ChangeHypothesis, pool: RunPool) -> DifferenceFit:
    """Score of simulated residuals as they are: a fit that moves nothing."""
    bare = replace(here, columns=[each[:, :, :0] for each in here.columns])
    matrices, centring = problem.gram_with_change(bare, pool), problem.differences.centring
    return score_differences(matrices, problem.deviation(here), centring, problem.settings)
