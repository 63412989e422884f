"""Fit from several starting points, to find a local optimum that is not the global one."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jax import numpy as jnp

from drftjax.common.errors import InputError
from identify.parameters.bijector import Interval, Positive, Scaled
from identify.parameters.parameter import Parameter
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.problem import Coordinates, Problem
from identify.solver.settings import MULTISTART_SETTINGS, MultistartSettings

# Starting points that a fit may be asked for, at most.
MAX_STARTS = 1000

# Seed of random draws: fixed, so that a fit made again gives the same numbers.
DRAWS_SEED = 0


@dataclass(frozen=True)
class MultistartSummary:
    """Outcome of several starting points.

    Attributes:
        count: Their number, the usual one among them.
        same: Number that ended in the best optimum.
        other: Number that ended in another, with a larger sum of squares.
        lost: Number that could not be simulated or did not converge.
        usual: True where the usual starting point ended in the best one.
    """

    count: int
    same: int
    other: int
    lost: int
    usual: bool

    def __str__(self) -> str:
        text = f"{self.same} of {self.count} starting points ended in the same optimum, the best"
        if self.other:
            text += f"; {self.other} in worse ones"
        if self.lost:
            text += f"; {self.lost} did not settle"
        return text + ("" if self.usual else "; the usual one did not end there")


def require_starts(count: int) -> None:
    """Raise InputError for a number of starting points outside 1 to `MAX_STARTS`."""
    if not 1 <= count <= MAX_STARTS:
        raise InputError(
            f"the number of starts is {count}, must lie between 1 and {MAX_STARTS} (--starts)"
        )


def best_start(
    problem: Problem,
    runs: int,
    count: int,
    seed: int = DRAWS_SEED,
    progress: Callable[[int, int], None] | None = None,
    settings: MultistartSettings = MULTISTART_SETTINGS,
) -> tuple[Coordinates, MultistartSummary]:
    """Fit from `count` points at once and keep the best.

    Args:
        problem: Runs and parameters.
        runs: Number of true runs.
        count: Starting points, the problem's own among them.
        seed: Of the others' places.
        progress: See `BatchedLevenbergMarquardt.run`.
        settings: Decision numbers.

    Returns:
        Coordinates of the best end, and the outcome of all.

    Raises:
        InputError: for a number of starting points that cannot be.
    """
    require_starts(count)
    descent = BatchedLevenbergMarquardt(problem, runs)
    points = starting_points(descent, count, np.random.default_rng(seed), settings)
    ends = descent.run(points, progress=progress)
    best = int(np.argmin(ends.loss))
    # An end that has not settled may still be the best one on its way.
    near = ends.loss <= (1 + settings.same_optimum) * ends.loss[best]
    other = ends.converged & ~near
    summary = MultistartSummary(
        count, int(near.sum()), int(other.sum()), int((~near & ~other).sum()), bool(near[0])
    )
    return descent.coordinates(ends.points[best]), summary


def starting_points(
    descent: BatchedLevenbergMarquardt,
    count: int,
    random: np.random.Generator,
    settings: MultistartSettings = MULTISTART_SETTINGS,
) -> np.ndarray:
    """Return the problem's own start and a Latin hypercube about it, shape (count, coordinates)."""
    usual = descent.start()
    points = np.tile(usual, (count, 1))
    others = count - 1
    for column, parameter in enumerate(descent.parameters):
        strata = (random.permutation(others) + random.random(others)) / max(others, 1)
        points[1:, column] = _spread(parameter, usual[column], 2 * strata - 1, settings)
    return points


def _spread(
    parameter: Parameter, usual: float, share: np.ndarray, settings: MultistartSettings
) -> np.ndarray:
    """Return coordinates at these shares, -1 to 1, of the range of starts."""
    match parameter.bijector:
        case Positive():
            return usual + settings.positive_range * share
        case Interval(low=low, high=high):
            values = (low + high) / 2 + settings.bounded_range * share * (high - low) / 2
            return np.asarray(parameter.bijector.coordinate(jnp.asarray(values)))
        case Scaled():
            return usual + settings.typical_changes * share
    return usual + share
