"""Activity of the online tuner of Fuke et al. 2024, eq. 7, without effects and with them.

Recorded runs are replayed through `drftjax.tuning.replay.replay_trial`. Each replay starts from the
matched zeta of the run by the model that it is replayed with, so that only the later changes of
zeta count. The tuner compares true sinkages: it sees no effect on a sensor. The sinkage error that
remains is small with any model, right or wrong.

A run that was made in the loop is replayed in that loop: its tuner, tick and readings, and a
simulated carriage that is free, as the loop's is; its first zeta is that of the sinkage at rest.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import with_effects
from diagnose.run_pool import RunPool
from drftjax.common.errors import InputError, RunError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.serialization import entry_of
from drftjax.recorded.commanded_motion import is_commanded_to_move
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from drftjax.tuning.replay import (
    ReplayedTuning,
    known_sinkage,
    replay_trial,
    require_finite_replay,
    tick_grid,
)
from drftjax.tuning.step_tuner import StepTuner
from hils.replay import replay_tuning


@dataclass(frozen=True, eq=False)
class TunerActivity:
    r"""Changes of zeta in one replay, over the ticks on which the wheel is commanded to move.

    Attributes:
        moved: Sum of changes, $\sum_k |\zeta_k - \zeta_{k-1}|$ [-].
        range: Largest minus smallest zeta [-].
        sinkage: RMS error of the simulated sinkage while it is tuned [m]; NaN where it never is.
        time: Of these ticks [s], shape (ticks,).
        zeta: On each of them [-], shape (ticks,).
        in_its_loop: True where the run was replayed in the loop that it was made in.
    """

    moved: float
    range: float
    sinkage: float
    time: np.ndarray
    zeta: np.ndarray
    in_its_loop: bool = False


def tuner_activity(
    dataset: RigDataset,
    effects: Sequence[AbstractEffect],
    zeta: Callable[[int], tuple[float, float]],
    tuner: StepTuner,
) -> list[tuple[TunerActivity, TunerActivity]]:
    """By run, the tuner's activity with the reference model and with the effects.

    Args:
        dataset: The runs.
        effects: Of the model.
        zeta: Matched zeta of a run, by its index, with the reference model and with the effects.
        tuner: Of runs that were not made in the loop.

    Returns:
        For each run, the activity by the reference model and with the effects.

    Raises:
        InputError: a replay diverges, or no tick falls where a wheel moves.
    """
    effects = tuple(effects)
    longest = max(float(each.trial.time[-1]) for each in dataset.runs)
    finest = min(float(each.trial.step) for each in dataset.runs)
    grid = tick_grid(longest, float(tuner.tick), finest)

    def of(run: int) -> tuple[TunerActivity, TunerActivity]:
        if _has_its_loop(dataset.runs[run]):
            return _in_its_loop(dataset, run, ()), _in_its_loop(dataset, run, effects)
        observation = dataset.runs[run].observation
        known = known_sinkage(grid.starts, observation.time, observation.sinkage())
        recorded = jnp.asarray(known)

        def moved(effects: tuple[AbstractEffect, ...], zeta: float) -> TunerActivity:
            arrays = jax.tree.map(jnp.asarray, effects)
            start = jnp.asarray(zeta)
            found = _replay(dataset.trials[run], arrays, start, recorded, tuner, grid.substeps)
            return _activity(dataset, run, ReplayedTuning(grid.starts, *map(np.asarray, found)))

        before, after = zeta(run)
        return moved((), before), moved(effects, after)

    with RunPool() as pool:
        return dataset.map(pool, of)


def _has_its_loop(each: PreparedRun) -> bool:
    """True where the run log holds the loop that the run was made in."""
    made = each.made_in_loop
    return made is not None and made.online is not None and made.online.loop is not None


def _in_its_loop(
    dataset: RigDataset, run: int, effects: tuple[AbstractEffect, ...]
) -> TunerActivity:
    """Activity in the loop that the run was made in, with the effects in its simulation."""
    each = dataset.runs[run]
    assert each.made_in_loop is not None
    try:
        replayed = replay_tuning(each.made_in_loop, [*map(entry_of, effects)], each.setup.start.x)
    except InputError as problem:
        raise RunError(each.name, str(problem)) from None
    return replace(_activity(dataset, run, replayed), in_its_loop=True)


@eqx.filter_jit
def _replay(
    trial: Trial,
    effects: tuple[AbstractEffect, ...],
    zeta: Float[Array, ""],
    recorded: Float[Array, " ticks"],
    tuner: StepTuner,
    substeps: int,
) -> tuple[Float[Array, " ticks"], Float[Array, " ticks"]]:
    """zeta on each tick, NaN where the replay diverges, and the error of the sinkage [m]."""
    found = replay_trial(with_effects(trial, effects), zeta, recorded, tuner, substeps)
    return jnp.where(jnp.isfinite(found.output.z), found.zeta, jnp.nan), found.error


def _activity(dataset: RigDataset, run: int, replayed: ReplayedTuning) -> TunerActivity:
    """Motion of zeta over the ticks on which the wheel is commanded to move."""
    each, starts = dataset.runs[run], replayed.time
    knots = np.asarray(each.trial.time)
    moving = np.flatnonzero(is_commanded_to_move(each.trial, starts) & (starts < knots[-1]))
    if not moving.size:
        raise InputError(f"{each.name}: no tick falls where the wheel moves; give a shorter tick")
    ticks = slice(moving[0], moving[-1] + 1)
    zeta, error = replayed.zeta[ticks], replayed.error[ticks]
    require_finite_replay(each.name, zeta)
    known = error[np.isfinite(error)]
    return TunerActivity(
        moved=float(np.abs(np.diff(zeta)).sum()),
        range=float(np.ptp(zeta)),
        sinkage=float(np.sqrt(np.mean(known**2))) if known.size else math.nan,
        time=starts[ticks],
        zeta=zeta,
    )
