"""Several starting points: whether a fit ends where it should, or in a valley of its own."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jax import numpy as jnp

from drftjax.common.errors import InputError
from identify.parameters.bijector import Interval, Positive, Scaled
from identify.parameters.parameter import Parameter
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.problem import Coordinates, Problem

# Starting points scatter by a factor of e^0.5 either way (positive numbers), over the middle of
# their bounds [-], or by so many of their typical changes (others).
FACTOR, MIDDLE, CHANGES = 0.5, 0.6, 3.0


# Two ends are the same optimum where their sums of squares differ by less than this share.
SAME_OPTIMUM = 0.02


MOST_STARTS = 1000


@dataclass(frozen=True)
class MultistartSummary:
    """What became of several starting points.

    Attributes:
        count: How many there were, the usual one among them.
        same: How many ended in the best optimum.
        other: How many ended in another, with a larger sum of squares.
        lost: How many could not be simulated or did not settle.
        usual: Whether the usual starting point ended in the best one.
    """

    count: int
    same: int
    other: int
    lost: int
    usual: bool

    def __str__(self) -> str:
        told = f"{self.same} of {self.count} starting points ended in the same optimum, the best"
        if self.other:
            told += f"; {self.other} in worse ones"
        if self.lost:
            told += f"; {self.lost} did not settle"
        return told + ("" if self.usual else "; the usual one did not end there")


def require_starts(count: int) -> None:
    """Refuse a number of starting points that makes no sense."""
    if not 1 <= count <= MOST_STARTS:
        raise InputError(
            f"the number of starts is {count}, must lie between 1 and {MOST_STARTS} (--starts)"
        )


def best_start(
    problem: Problem,
    runs: int,
    count: int,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Coordinates, MultistartSummary]:
    """Fit from `count` points at once and keep the best.

    Args:
        problem: Runs and parameters.
        runs: Number of true runs.
        count: Starting points, the problem's own among them.
        seed: Of the others' places.
        progress: See `BatchedLevenbergMarquardt.run`.

    Returns:
        Coordinates of the best end, and what became of all.
    """
    require_starts(count)
    descent = BatchedLevenbergMarquardt(problem, runs)
    points = starting_points(descent, count, np.random.default_rng(seed))
    ends = descent.run(points, progress=progress)
    best = int(np.argmin(ends.loss))
    # An end that has not settled may still be the best one on its way.
    near = ends.loss <= (1 + SAME_OPTIMUM) * ends.loss[best]
    other = ends.converged & ~near
    told = MultistartSummary(
        count, int(near.sum()), int(other.sum()), int((~near & ~other).sum()), bool(near[0])
    )
    return descent.coordinates(ends.points[best]), told


def starting_points(
    descent: BatchedLevenbergMarquardt, count: int, random: np.random.Generator
) -> np.ndarray:
    """The problem's own start, then others about it: a Latin hypercube over all coordinates."""
    usual = descent.start()
    points = np.tile(usual, (count, 1))
    others = count - 1
    for column, parameter in enumerate(descent.parameters):
        strata = (random.permutation(others) + random.random(others)) / max(others, 1)
        points[1:, column] = _spread(parameter, usual[column], 2 * strata - 1)
    return points


def _spread(parameter: Parameter, usual: float, share: np.ndarray) -> np.ndarray:
    """Coordinates at these shares, -1 to 1, of the way that a start may scatter."""
    match parameter.bijector:
        case Positive():
            return usual + FACTOR * share
        case Interval(low=low, high=high):
            values = (low + high) / 2 + MIDDLE * share * (high - low) / 2
            return np.asarray(parameter.bijector.coordinate(jnp.asarray(values)))
        case Scaled():
            return usual + CHANGES * share
    return usual + share
