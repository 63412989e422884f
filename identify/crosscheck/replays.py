"""Eq. 7 replayed over recorded runs under several settings, as one compiled program."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import RunError
from drftjax.physics.command import Command
from drftjax.recorded.batch import make_batch
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.trial import Trial
from drftjax.tuning.step_tuner import Loop, StepTuner, known_sinkage, replay, tick_commands

# The shortest tick of the sweep divides every other.
FINER = 4


@dataclass(frozen=True)
class TunerSetting:
    """A tuner's numbers [s], [-], [m]."""

    tick: float
    zeta_step: float
    tolerance: float


@dataclass(frozen=True, eq=False)
class ReplayedTuner:
    """One run under every setting, on the finest tick; arrays of shape (settings, ticks)."""

    time: np.ndarray
    zeta: np.ndarray
    error: np.ndarray
    z: np.ndarray
    x: np.ndarray
    every: list[int]


def replay_settings(
    candidates: Sequence[PreparedRun], settings: Sequence[TunerSetting]
) -> list[ReplayedTuner]:
    """Every run under every setting.

    All settings are stepped on one fine tick. A tick in between, on which a setting does not
    measure, is one without a measurement, which leaves zeta as it is.
    """
    wanted = [StepTuner(s.tick, s.zeta_step, s.tolerance) for s in settings]
    tick = settings[0].tick / FINER
    every = [round(s.tick / tick) for s in settings]
    batch = make_batch([c.trial for c in candidates], [c.observation for c in candidates])
    longest = max(c.setup.integrator.step for c in candidates)
    substeps = max(1, math.ceil(tick / longest - 1e-9))
    lengths = [max(1, math.ceil(float(c.trial.time[-1]) / tick - 1e-9)) for c in candidates]
    starts = tick * np.arange(max(lengths))
    recorded = np.stack([_recorded(c, starts, every) for c in candidates])
    tuners = jax.tree.map(
        lambda *leaves: jnp.stack(leaves),
        *(eqx.tree_at(lambda t: t.tick, each, jnp.asarray(tick)) for each in wanted),
    )
    first = jnp.asarray([_first_zeta(c.trial) for c in candidates])
    commands = jax.vmap(
        lambda t: tick_commands(max(lengths), substeps, tick, t.time, t.omega, t.vx)
    )(batch.trials)
    found = _replay_all(batch.trials, first, commands, jnp.asarray(recorded), tuners)
    zeta, error, z, x = map(np.asarray, found)
    for each, replayed in zip(candidates, z[:, 0], strict=True):
        if not np.isfinite(replayed).all():
            raise RunError(
                each.name,
                "a replay of the tuner diverges; give a shorter tick or a smaller step",
            )
    return [
        ReplayedTuner(starts[:n], zeta[i, :, :n], error[i, :, :n], z[i, :, :n], x[i, :, :n], every)
        for i, n in enumerate(lengths)
    ]


def _recorded(each: PreparedRun, starts: np.ndarray, every: Sequence[int]) -> np.ndarray:
    """Sinkage known on the fine ticks that a setting measures on, shape (settings, ticks)."""
    observation = each.observation
    if "z" not in observation.channels:
        raise RunError(each.name, "has no /measured/z, so its sinkage is not known")
    z = observation.values[observation.channels.index("z")]
    known = known_sinkage(starts, observation.time, -z)
    number = np.arange(len(starts))
    return np.stack([np.where(number % n == 0, known, np.nan) for n in every])


def _first_zeta(trial: Trial) -> Array:
    first = Command(trial.omega[0], trial.vx[0], trial.omega[0])
    return trial.simulator.terrain.zeta(jnp.zeros_like(trial.step), first)


@eqx.filter_jit
def _replay_all(
    trials: Trial,
    zeta: Float[Array, " runs"],
    commands: Command,
    recorded: Float[Array, "runs settings ticks"],
    tuners: StepTuner,
) -> tuple[Array, ...]:
    """zeta, error, z and x, each of shape (runs, settings, ticks)."""

    def one(trial: Trial, zeta: Array, commands: Command, recorded: Array, tuner: StepTuner):
        start = Loop(trial.start, zeta)
        _, tick = replay(trial.simulator, start, commands, recorded, tuner)
        return tick.zeta, tick.error, tick.output.z, tick.output.x

    settings = jax.vmap(one, in_axes=(None, None, None, 0, 0))
    return jax.vmap(settings, in_axes=(0, 0, 0, 0, None))(trials, zeta, commands, recorded, tuners)
