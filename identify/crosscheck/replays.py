"""Eq. 7 replayed over recorded runs under several settings, as one compiled program."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError, RunError
from drftjax.physics.command import Command
from drftjax.recorded.batch import make_batch
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from drftjax.tuning.replay import (
    known_sinkage,
    replay_trial,
    require_finite_replay,
    tick_count,
    tick_grid,
)
from drftjax.tuning.step_tuner import StepTuner

# Fine ticks to one tick of the first setting: the shortest tick of the sweep divides every other.
FINER = 4


@dataclass(frozen=True)
class TunerSetting:
    """Numbers of eq. 7.

    Attributes:
        tick: Control period [s].
        zeta_step: Change of zeta on one tick [-].
        tolerance: Error of the sinkage that is left alone [m].
    """

    tick: float
    zeta_step: float
    tolerance: float


@dataclass(frozen=True, eq=False)
class ReplayedTuner:
    """One run under every setting, on the finest tick; arrays of shape (settings, ticks).

    Attributes:
        time: Starts of the fine ticks [s], shape (ticks,).
        zeta: Scaling factor over each [-].
        error: Recorded minus simulated sinkage at its start [m]; NaN where a setting measures none.
        z, x: Simulated axle position at its end [m].
        every: Fine ticks to a tick, by setting.
    """

    time: np.ndarray
    zeta: np.ndarray
    error: np.ndarray
    z: np.ndarray
    x: np.ndarray
    every: list[int]


def replay_settings(
    candidates: Sequence[PreparedRun], settings: Sequence[TunerSetting]
) -> list[ReplayedTuner]:
    """Replay every run under every setting.

    All settings are stepped on one fine tick. A tick in between, on which a setting does not
    measure, is one without a measurement, which leaves zeta as it is.

    Args:
        candidates: Runs that one program simulates.
        settings: Settings of eq. 7; the first one's tick, over `FINER`, is the fine tick.

    Raises:
        RunError: a run without a recorded sinkage, or whose replay diverges.
    """
    wanted = [StepTuner(s.tick, s.zeta_step, s.tolerance) for s in settings]
    tick = settings[0].tick / FINER
    every = [round(s.tick / tick) for s in settings]
    trials = make_batch([c.trial for c in candidates], [c.observation for c in candidates]).trials
    durations = [float(c.trial.time[-1]) for c in candidates]
    grid = tick_grid(max(durations), tick, max(float(c.trial.step) for c in candidates))
    recorded = np.stack([_recorded(c, grid.starts, every) for c in candidates])
    tuners = jax.tree.map(
        lambda *leaves: jnp.stack(leaves),
        *(eqx.tree_at(lambda t: t.tick, each, jnp.asarray(tick)) for each in wanted),
    )
    first = jnp.asarray([_first_zeta(c.trial) for c in candidates])
    found = _replay_all(trials, first, jnp.asarray(recorded), tuners, grid.substeps)
    zeta, error, z, x = map(np.asarray, found)
    for each, replayed in zip(candidates, z[:, 0], strict=True):
        require_finite_replay(each.name, replayed)
    lengths = [tick_count(duration, tick) for duration in durations]
    return [
        ReplayedTuner(
            grid.starts[:n], zeta[i, :, :n], error[i, :, :n], z[i, :, :n], x[i, :, :n], every
        )
        for i, n in enumerate(lengths)
    ]


def _recorded(each: PreparedRun, starts: np.ndarray, every: Sequence[int]) -> np.ndarray:
    """Sinkage known on the fine ticks that a setting measures on [m], shape (settings, ticks)."""
    try:
        sinkage = each.observation.sinkage()
    except InputError as problem:
        raise RunError(each.name, str(problem)) from None
    known = known_sinkage(starts, each.observation.time, sinkage)
    number = np.arange(len(starts))
    return np.stack([np.where(number % n == 0, known, np.nan) for n in every])


def _first_zeta(trial: Trial) -> Array:
    first = Command(trial.omega[0], trial.vx[0], trial.omega[0])
    return trial.simulator.terrain.zeta(jnp.zeros_like(trial.step), first)


@eqx.filter_jit
def _replay_all(
    trials: Trial,
    zeta: Float[Array, " runs"],
    recorded: Float[Array, "runs settings ticks"],
    tuners: StepTuner,
    substeps: int,
) -> tuple[Array, ...]:
    """zeta, error, z and x, each of shape (runs, settings, ticks)."""

    def one(trial: Trial, zeta: Array, recorded: Array, tuner: StepTuner) -> tuple[Array, ...]:
        tick = replay_trial(trial, zeta, recorded, tuner, substeps)
        return tick.zeta, tick.error, tick.output.z, tick.output.x

    settings = jax.vmap(one, in_axes=(None, None, 0, 0))
    return jax.vmap(settings, in_axes=(0, 0, 0, None))(trials, zeta, recorded, tuners)
