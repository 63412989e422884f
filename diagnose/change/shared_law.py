"""A base that follows the runs: what before and now share, as far as a few numbers describe it.

The responses to effects are those about a simulation. Where the sand follows another law, or the
rig has had a fault all along, a simulation that knows nothing of it gives responses that are wrong
by a tenth or more. So a few numbers are fitted to the runs before, and all that follows is relative
to that. What they leave is no matter: it is shared.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.dataset import (
    RigDataset,
    in_short_steps,
    match_initial_zeta,
    without_step_errors,
)
from diagnose.hypotheses.hypothesis import lower_bounds
from diagnose.linear.linear_fit import WITHOUT_LEVELS, fit_linear, floor_inflation
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel, with_effects
from diagnose.run_pool import RunPool
from drftjax.common.errors import InputError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import shapes
from drftjax.effects.stress import DepthPower
from drftjax.effects.terrain import Heap
from drftjax.recorded.prepared_run import PreparedRun

LAW: tuple[type[AbstractEffect], ...] = (DepthPower, Heap)
"""Effects of the base: the exponent of depth, and a heap ahead, which grows as the wheel sinks."""


@dataclass(frozen=True)
class SharedLawSettings:
    """Numbers by which the base is fitted.

    Attributes:
        width: Width of the prior on each number [typical sizes]: exponents of depth of 0.8 to 1.4
            are common, and a healthy rig pulls and bears by some newtons.
        max_step: Longest change of a number in one round [typical sizes].
        rounds: Rounds of linearisation and fit at most, as responses change with the law.
        floor_shares: In the first rounds every model error is raised to this share of the worst
            block's RMS in model errors [-], so that the blocks that are missed by most lead.
        settled: After these, rounds end where no number moves by more than this [typical sizes].
    """

    width: float = 2.0
    max_step: float = 3.0
    rounds: int = 8
    floor_shares: tuple[float, ...] = (0.3, 0.1, 0.03)
    settled: float = 0.3


DEFAULT_SHARED_LAW = SharedLawSettings()


def follow_shared_law(
    dataset: RigDataset,
    before: Sequence[int],
    pool: RunPool,
    settings: SharedLawSettings = DEFAULT_SHARED_LAW,
) -> tuple[RigDataset, tuple[AbstractEffect, ...]]:
    """The dataset whose reference model has a law that follows the runs before.

    Args:
        dataset: Runs before and now.
        before: Numbers of those before.
        pool: Threads.
        settings: Numbers of the fit.

    Returns:
        The dataset without errors of the step, and the effects that its model has.

    Raises:
        InputError: where no run has a sinkage.
        RunError: where a run cannot be simulated.
    """
    model = AugmentedModel(tuple(each for each in LAW if _is_possible(dataset.runs, each)))
    at = model.null()
    strengths = np.array([free.scale is not None for free in model.free])
    with_null = RigDataset.of(_with_law(dataset.runs, model, at), dataset.settings)
    runs = without_step_errors(in_short_steps(with_null), pool).runs
    for turn in range(settings.rounds):
        base = RigDataset.of([runs[run] for run in before], dataset.settings)
        linearized = linearize_runs(base, match_initial_zeta(base, pool), pool)
        responses = Regressors.of(base, linearized, model.effects, pool, WITHOUT_LEVELS)
        matrices = responses.gram_matrices
        missed = fit_linear(matrices, (), settings=WITHOUT_LEVELS).mean_square
        share = settings.floor_shares[turn] if turn < len(settings.floor_shares) else 0.0
        least = [bound for each in model.effects for bound in lower_bounds(each)]
        fit = fit_linear(
            matrices,
            [column for each in responses.variants if _is_default(each) for column in each.columns],
            prior=np.full(strengths.sum(), settings.width),
            offset=at[strengths],
            lower=np.array(least) - at[strengths],
            linear_error=0.0,
            inflation=floor_inflation(matrices.blocks, missed, share, WITHOUT_LEVELS),
            settings=WITHOUT_LEVELS,
        )
        if not np.isfinite(fit.coefficients).all():
            break  # A run's wheel falls at this law, so that it has no derivative.
        step = np.clip(fit.coefficients, -settings.max_step, settings.max_step)
        at[strengths] += step
        runs = _with_law([_without_law(each, len(model.effects)) for each in runs], model, at)
        if share == 0 and np.abs(step).max(initial=0.0) < settings.settled:
            break
    return RigDataset.of(runs, dataset.settings), model.build(at)


def _with_law(
    runs: Sequence[PreparedRun], model: AugmentedModel, at: np.ndarray
) -> list[PreparedRun]:
    effects = model.build(at)
    return [replace(each, trial=with_effects(each.trial, effects)) for each in runs]


def _without_law(each: PreparedRun, count: int) -> PreparedRun:
    """The run without the effects that were added last."""
    effects = each.trial.simulator.effects
    simulator = replace(each.trial.simulator, effects=effects[: len(effects) - count])
    return replace(each, trial=replace(each.trial, simulator=simulator))


def _is_default(variant: ShapeVariant) -> bool:
    """True for an effect with its shapes as they are by default."""
    null = variant.effect()
    own = [float(getattr(null, name)) for name in shapes(variant.effect)]
    return bool(np.allclose(variant.shapes, own))


def _is_possible(runs: Sequence[PreparedRun], effect: type[AbstractEffect]) -> bool:
    """True where the wheel, the law and the carriage can have an effect."""
    try:
        replace(runs[0].trial.simulator, effects=(effect(),)).check()
    except InputError:
        return False
    return True
