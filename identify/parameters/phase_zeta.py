"""zeta by phase of the command: standing, accelerating, steady, decelerating, at rest."""

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from drftjax.common.errors import InputError
from drftjax.physics.command import Command, with_zero_crossings
from drftjax.physics.terrain import AbstractZeta, ConstantZeta
from drftjax.recorded.observation import ROUNDING
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.command_knots import DEFAULT_KNOTS, simplify_command
from drftjax.setups.setup import SetUp
from drftjax.setups.terrain_setup import ZetaKnots
from identify.parameters.parameter import PHASE_PREFIX, PHASES, Parameter, parameter, quantity


@dataclasses.dataclass(frozen=True)
class PhaseSettings:
    """Numbers of the phases of a command.

    Attributes:
        steady_change: Change of speed below which a phase is steady, as a share of the run's
            largest speed in a second [1/s].
        ramp: Regulariser: duration of the change from one phase's zeta to the next, unless a
            quarter of the shorter phase is less [s].
    """

    steady_change: float = 0.01
    ramp: float = 0.02


PHASE_SETTINGS = PhaseSettings()


class PhaseZeta(AbstractZeta):
    """zeta with one value for each phase, linear over short ramps between them.

    Attributes:
        time: Knots from the run's start, increasing [s], shape (knots,).
        phase: Number of the phase at each, shape (knots,).
        level: zeta of each phase [-], in the order of `PHASES`.
    """

    time: Float[Array, " knots"]
    phase: Int[Array, " knots"]
    level: Float[Array, " phases"]

    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        return jnp.interp(time, self.time, self.level[self.phase])

    def knots(self) -> ZetaKnots:
        """Return the same as a set-up file holds it."""
        phase = np.asarray(self.phase)
        # Knots that only pad a batch repeat the last phase.
        used = 1 + int(np.flatnonzero(np.diff(phase, prepend=-1))[-1])
        values = np.asarray(self.level)[phase[:used]]
        return ZetaKnots(np.asarray(self.time)[:used].tolist(), values.tolist())


def phases_of(
    setup: SetUp, settings: PhaseSettings = PHASE_SETTINGS
) -> list[tuple[float, float, str]]:
    """Return start, end [s] from the run's start, and name of each phase of a command, in order.

    By the wheel's speed in either direction, or the carriage's where the wheel never turns. A wheel
    that turns back decelerates and accelerates again. Scatter of a measured speed is no phase.
    """
    command = simplify_command(setup.command).build()
    turns = command.omega.any() or command.vx is None
    moving = command.omega if turns else command.vx
    assert moving is not None
    top = max(float(np.abs(moving).max()), np.finfo(float).tiny)
    moving = np.where(np.abs(moving) <= DEFAULT_KNOTS.scatter * top, 0.0, moving)
    time, moving = with_zero_crossings(command.time - command.time[0], moving)
    speed = np.abs(moving)
    found: list[tuple[float, float, str]] = []
    moved = False
    for begin, end, first, last in zip(time, time[1:], speed, speed[1:], strict=False):
        change = (last - first) / (end - begin) / top
        if first == 0 and last == 0:
            name = "rest" if moved else "stand"
        elif (
            abs(change) < settings.steady_change or abs(last - first) <= DEFAULT_KNOTS.scatter * top
        ):
            name = "steady"
        else:
            name = "accelerate" if change > 0 else "decelerate"
        moved = moved or last > 0
        if found and found[-1][2] == name:
            found[-1] = (found[-1][0], float(end), name)
        else:
            found.append((float(begin), float(end), name))
    return found


def zeta_phases(
    runs: Sequence[PreparedRun], parameters: Sequence[Parameter] = ()
) -> list[Parameter]:
    """Return one zeta for each phase in which any run has samples, then the other parameters.

    They replace zeta among the parameters; its prior, its bounds and its being shared hold for each
    phase. A phase that is a parameter by itself stays as it is.
    """
    present = {name for each in runs for name in _compared(each)}
    others = {p.quantity.name: p for p in parameters}
    whole = others.pop("terrain.zeta", parameter("zeta", shared=False))
    phases = [quantity(PHASE_PREFIX + name) for name in PHASES if name in present]
    new = [dataclasses.replace(whole, quantity=q) for q in phases if q.name not in others]
    return [*new, *others.values()]


def _compared(each: PreparedRun) -> set[str]:
    # A sample at the end of a phase belongs to it, whatever its clock rounds.
    time = each.observation.time[each.observation.counts] - ROUNDING
    return {
        name for begin, end, name in phases_of(each.setup) if np.any((time > begin) & (time <= end))
    }


def has_phase_zeta(parameters: Sequence[Parameter]) -> bool:
    """True if any of them is the zeta of a phase."""
    return any(p.quantity.name.startswith(PHASE_PREFIX) for p in parameters)


def with_phases(runs: Sequence[PreparedRun], parameters: Sequence[Parameter]) -> list[PreparedRun]:
    """Return the runs with zeta by phase, all phases at the run's own value.

    Raises:
        InputError: where no run has samples in a phase that is to be fitted.
    """
    present = {name for each in runs for name in _compared(each)}
    for each in parameters:
        name = each.quantity.name.removeprefix(PHASE_PREFIX)
        if name != each.quantity.name and name not in present and runs:
            known = ", ".join(phase for phase in PHASES if phase in present)
            raise InputError(f"no run has samples in the phase {name!r}; they have {known}")
    grids = [_grid(each) for each in runs]
    most = max((len(time) for time, _ in grids), default=0)
    return [_with_phases(each, *grid, most) for each, grid in zip(runs, grids, strict=True)]


def _grid(
    each: PreparedRun, settings: PhaseSettings = PHASE_SETTINGS
) -> tuple[np.ndarray, np.ndarray]:
    """Return the knots [s] of a run's zeta by phase, and the phase of each."""
    phases = phases_of(each.setup)
    time, number = [0.0], [PHASES.index(phases[0][2])]
    for (begin, middle, before), (_, end, after) in pairwise(phases):
        half = min(settings.ramp, (middle - begin) / 4, (end - middle) / 4) / 2
        time += [middle - half, middle + half]
        number += [PHASES.index(before), PHASES.index(after)]
    return np.array(time), np.array(number)


def _with_phases(each: PreparedRun, time: np.ndarray, phase: np.ndarray, most: int) -> PreparedRun:
    zeta = each.trial.simulator.terrain.zeta
    if not isinstance(zeta, ConstantZeta):
        raise InputError(f"{each.name}: its zeta is not constant, must be to be fitted by phase")
    missing = most - len(time)
    later = max(float(time[-1]), float(each.trial.time[-1])) + np.arange(1.0, missing + 1)
    by = PhaseZeta(
        jnp.asarray(np.r_[time, later]),
        jnp.asarray(np.r_[phase, np.repeat(phase[-1:], missing)]),
        jnp.broadcast_to(zeta.value, (len(PHASES),)),
    )
    trial = eqx.tree_at(lambda t: t.simulator.terrain.zeta, each.trial, by)
    return dataclasses.replace(each, trial=trial)
