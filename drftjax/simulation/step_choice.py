"""Step length of a run, chosen by an estimate of its error.

A run is simulated with a step and with half of it. The step is of first order, so twice the
difference estimates the error of the longer one, of the path and of its derivative by the
logarithm of zeta. The longest step whose estimates are within the limits is taken; mass, sand,
wheel and command all have their say in it.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from drftjax.common.arrays import as_real
from drftjax.physics.command import Command
from drftjax.physics.terrain import AbstractZeta
from drftjax.simulation.rollout import sweep
from drftjax.simulation.trial import Trial, pad_to_shared_size


@dataclass(frozen=True)
class StepSettings:
    """Limits of the error by which a step is chosen.

    Attributes:
        longest: Longest step [s].
        turn: Angle that a wheel turns by in a step at most [rad]: a plate of a rolling wheel begins
            to lead within 3e-3, and steps that miss it are off by where they happen to fall.
        turn_back: The same of a wheel that turns both ways, whose place at the end is the small
            difference of two ways [rad].
        halvings: Times that the longest step is halved at most.
        sinkage: RMS error of z [m]: under half of the 0.1 mm that a user may rely on, which
            leaves room for the length of plates and the width at rest.
        sinkage_of_radius: The same for a larger wheel, as a share of its radius [-].
        travel: Error of the final x [m].
        slope: Error of derivatives by the logarithm of zeta [-]: of z, RMS as a share of its own;
            of the final x, as a share of the travel, or of the radius where that is more.
    """

    longest: float = 1e-2
    turn: float = 5.3e-3
    turn_back: float = 2.65e-3
    halvings: int = 4
    sinkage: float = 4e-5
    sinkage_of_radius: float = 2.5e-4
    travel: float = 1e-3
    slope: float = 0.05


DEFAULT_STEPS = StepSettings()


@dataclass(frozen=True)
class StepChoice:
    """A step, and the estimate of its error.

    Attributes:
        step: Step [s].
        sinkage_error: RMS error of z [m].
        travel_error: Error of the final x [m].
        slope_error: Error of derivatives by the logarithm of zeta [-], the larger of that of z and
            that of the final x, each as `StepSettings` has it.
        within: Whether all three are within the limits; if not, the shortest step was taken.
    """

    step: float
    sinkage_error: float
    travel_error: float
    slope_error: float
    within: bool

    def __str__(self) -> str:
        """One sentence for a report or a log."""
        limits = "" if self.within else ", more than wanted even so; it is the shortest tried"
        return (
            f"step {1e3 * self.step:g} ms, estimated error: z {1e3 * self.sinkage_error:.2g} mm, "
            f"final x {1e3 * self.travel_error:.2g} mm, derivatives {self.slope_error:.1%}{limits}"
        )


def choose_step(trial: Trial, settings: StepSettings = DEFAULT_STEPS) -> StepChoice:
    """The longest step at which a run's estimated error is within the limits.

    Args:
        trial: The run; its own step is not used.
        settings: Limits of the error.
    """
    longest = settings.longest
    rows = int(np.ceil(float(trial.time[-1]) / longest - 1e-9))
    padded = pad_to_shared_size(replace(trial, step=as_real(0.0), every=1, rows=rows))
    radius = float(trial.simulator.wheel.radius)
    omega = np.asarray(trial.omega)
    turn = settings.turn_back if omega.min() < 0 < omega.max() else settings.turn
    least = np.ceil(np.log2(max(1.0, longest * float(trial.top_speed()) / turn)))
    first = min(settings.halvings, int(least))
    parts = 2**first
    before, choice = _path(padded, longest, rows, parts), None
    for _ in range(first, settings.halvings + 1):
        after = _path(padded, longest, rows, 2 * parts)
        choice = _judged(longest / parts, before, after, radius, settings)
        if choice.within:
            break
        parts, before = 2 * parts, after
    assert choice is not None
    return choice


def _judged(
    step: float, before: np.ndarray, after: np.ndarray, radius: float, settings: StepSettings
) -> StepChoice:
    """Estimate from runs with a step and with half of it, each of shape (4, rows)."""
    z, x, slope_z, slope_x = 2 * (before - after)
    sinkage, travel = _rms(z), float(abs(x[-1]))
    way = float(np.abs(np.diff(after[1])).sum())
    # A wheel that stands has no way; its x is judged like that of one that turns a radian.
    slopes = max(_share(_rms(slope_z), _rms(after[2])), abs(slope_x[-1]) / max(way, radius))
    within = (
        sinkage <= max(settings.sinkage, settings.sinkage_of_radius * radius)
        and travel <= settings.travel
        and slopes <= settings.slope
    )
    return StepChoice(step, sinkage, travel, slopes, bool(within))


def _share(error: float, whole: float) -> float:
    return float(error / whole) if whole > 0 else 0.0


def _rms(values: np.ndarray) -> float:
    with np.errstate(over="ignore"):  # what diverges is as far off as can be
        return float(np.sqrt(np.mean(values**2)))


def _path(trial: Trial, interval: float, rows: int, parts: int) -> np.ndarray:
    """z, x and their derivatives by ln zeta at every row, shape (4, rows)."""
    padded = _program(trial, as_real(interval), jnp.asarray(rows), jnp.asarray(parts))
    return np.asarray(padded)[:, :rows]


class _ScaledZeta(AbstractZeta):
    """A zeta times a factor.

    Attributes:
        zeta: Of the run.
        factor: [-].
    """

    zeta: AbstractZeta
    factor: Float[Array, ""]

    def __call__(self, time: Float[Array, ""], command: Command) -> Float[Array, ""]:
        return self.factor * self.zeta(time, command)


@eqx.filter_jit
def _program(
    trial: Trial, interval: Float[Array, ""], rows: Int[Array, ""], parts: Int[Array, ""]
) -> Float[Array, "4 rows"]:
    def path(factor: Float[Array, ""]) -> Float[Array, "2 rows"]:
        zeta = _ScaledZeta(trial.simulator.terrain.zeta, factor)
        simulator = eqx.tree_at(lambda s: s.terrain.zeta, trial.simulator, zeta)
        start = simulator, trial.start, trial.command, interval, parts, rows, trial.rows
        return sweep(*start, lambda output: jnp.stack([output.z, output.x]))[:, 1:]

    one = jnp.ones_like(interval)
    return jnp.concatenate(jax.jvp(path, (one,), (one,)))
