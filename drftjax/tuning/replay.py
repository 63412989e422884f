"""Replay of an online tuner beside a recorded run, as it would have tuned while the run was made.

Angular velocity and the simulated speed drive the rig, and nothing but the measured sinkage comes
back, so a recorded run holds all that the tuner was given. `replay_trial` scans the very tick that
runs online (`drftjax.tuning.step_tuner.tuned_tick`).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import RunError
from drftjax.physics.command import Command
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.trial import Trial
from drftjax.tuning.step_tuner import (
    AbstractTuner,
    Loop,
    Tick,
    tick_commands,
    tuned_tick,
    with_tuner_memory,
    with_zeta_per_step,
)


@dataclass(frozen=True)
class ReplaySettings:
    """Numbers that decide which recorded sample a tick knows.

    Attributes:
        max_age: Age at which a sample is old, in usual intervals of the record [-]: the next one
            should have come by then; loggers come a little late.
        clock_rounding: Difference of two clocks that write the same instant [s].
    """

    max_age: float = 1.5
    clock_rounding: float = 1e-9


DEFAULT_REPLAY = ReplaySettings()


class TickGrid(NamedTuple):
    """Ticks of a replay.

    Attributes:
        starts: Their starts from the run's first command on [s], shape (ticks,).
        substeps: Integrator steps in a tick.
    """

    starts: np.ndarray
    substeps: int


class ReplayedTuning(NamedTuple):
    """One run's tuner, replayed with one simulation.

    Attributes:
        time: Starts of the ticks [s], shape (ticks,).
        zeta: Scaling factor over each tick [-], shape (ticks,); NaN where the replay diverges.
        error: Measured minus simulated sinkage at its start [m], shape (ticks,); NaN without a
            reading to tune by.
    """

    time: np.ndarray
    zeta: np.ndarray
    error: np.ndarray


def tick_count(duration: float, tick: float) -> int:
    """Ticks [-] that cover a run of this duration [s], at least one."""
    return max(1, math.ceil(duration / tick - 1e-9))


def tick_grid(duration: float, tick: float, step: float) -> TickGrid:
    """Ticks that cover a run, each of whole integrator steps.

    Args:
        duration: Length of the command [s].
        tick: Control period [s].
        step: Longest integrator step [s].
    """
    starts = tick * np.arange(tick_count(duration, tick))
    return TickGrid(starts, max(1, math.ceil(tick / step - 1e-9)))


def known_sinkage(
    tick_time: np.ndarray,
    time: np.ndarray,
    sinkage: np.ndarray,
    settings: ReplaySettings = DEFAULT_REPLAY,
) -> np.ndarray:
    """Newest recorded sinkage [m] at or before each tick; NaN where there is none or it is old.

    The loop tunes nothing while no fresh reading comes, and a replay of it must not either.

    Args:
        tick_time: Starts of the ticks [s], shape (ticks,).
        time: Times of the record [s], increasing, shape (samples,).
        sinkage: Recorded sinkage [m], shape (samples,).
        settings: Age at which a sample is old.

    Returns:
        Sinkage known at each tick [m], shape (ticks,).
    """
    # A sample of the tick's own instant counts, whatever the rounding of either clock.
    newest = np.searchsorted(time, tick_time + settings.clock_rounding, side="right") - 1
    known = np.maximum(newest, 0)
    usual = np.median(np.diff(time)) if len(time) > 1 else np.inf
    fresh = (newest >= 0) & (tick_time - np.asarray(time)[known] < settings.max_age * usual)
    return np.where(fresh, np.asarray(sinkage)[known], np.nan)


def replay_tuner(
    simulator: Simulator,
    start: Loop,
    commands: Command,
    recorded: Float[Array, " ticks"],
    tuner: AbstractTuner,
) -> tuple[Loop, Tick]:
    """Scan the tuned tick over a recorded command and sinkage.

    Args:
        simulator: Every number of wheel, terrain and rig; its own zeta is not used.
        start: State and zeta at the first tick.
        commands: For every step, shape (ticks, substeps); see `tick_commands`.
        recorded: Sinkage known at each tick [m], shape (ticks,); see `known_sinkage`.
        tuner: Law that moves zeta.

    Returns:
        The loop at the end, and every tick.
    """
    simulator = with_zeta_per_step(simulator)

    def tick(loop: Loop, inputs: tuple[Command, Array]) -> tuple[Loop, Tick]:
        return tuned_tick(simulator, tuner, loop, *inputs)

    return jax.lax.scan(tick, with_tuner_memory(tuner, start), (commands, recorded))


def replay_trial(
    trial: Trial,
    zeta: Float[Array, ""],
    recorded: Float[Array, " ticks"],
    tuner: AbstractTuner,
    substeps: int,
) -> Tick:
    """Replay a tuner beside one recorded run, from the trial's start; to be compiled by the caller.

    Args:
        trial: Simulator, start and command of the run.
        zeta: Scaling factor at the start [-].
        recorded: Sinkage known at each tick [m], shape (ticks,).
        tuner: Law that moves zeta, and the tick [s].
        substeps: Integrator steps in a tick.

    Returns:
        Every tick, arrays of shape (ticks,).
    """
    ticks = recorded.shape[0]
    commands = tick_commands(ticks, substeps, tuner.tick, trial.time, trial.omega, trial.vx)
    first = Command(trial.omega[0], trial.vx[0], zeta)
    start = with_zeta_per_step(trial.simulator).remembered(trial.start, first)
    return replay_tuner(trial.simulator, Loop(start, zeta), commands, recorded, tuner)[1]


def require_finite_replay(name: str, values: np.ndarray) -> None:
    """Refuse a replay that diverged.

    Args:
        name: The run, as reports call it.
        values: Any channel of the replay, of any shape.

    Raises:
        RunError: a value is not finite.
    """
    if not np.isfinite(values).all():
        raise RunError(
            name, "a replay of the tuner diverges; give a shorter tick or a smaller step"
        )
