"""Levenberg-Marquardt from many points of one batch side by side, under one vmap.

Starting points, places of a profile and simulated recordings need the same: the batch and its
derivative at many coordinates at once. Steps and damping are optimistix's
(`identify.solver.descent`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.memory import chunk_bytes
from identify.parameters.parameter import Parameter
from identify.solver.descent import NormalEquations, levenberg_marquardt
from identify.solver.problem import Coordinates, Problem, normal_equations
from identify.solver.settings import BATCHED_SETTINGS, BatchedSolverSettings
from identify.solver.whitening import Whitening

# Derivatives of so many bytes at most are held at once; more points are taken in turns.
CHUNK_BYTES = 2e8


# Points are computed together by ones, fours, sixteens: few programs for any number of them.
CHUNK_GROWTH = 4


@dataclass(frozen=True, eq=False)
class BatchedSolution:
    """End of the iteration from each point.

    Attributes:
        points: Coordinates, shape (points, coordinates).
        loss: Sum of squares there, priors included; infinite where nothing could be simulated.
        converged: True where no further step gains anything, shape (points,).
    """

    points: np.ndarray
    loss: np.ndarray
    converged: np.ndarray


@eqx.filter_jit
def _blocks_at_all(problem: Problem, points: Coordinates) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(problem.blocks)(*points)


def _blocks_at(problem: Problem, points: Coordinates) -> tuple[jax.Array, ...]:
    if len(points[0]) > 1:
        return _blocks_at_all(problem, points)
    # The program that other callers compile for one point, too.
    return tuple(each[None] for each in problem.blocks(points[0][0], points[1][0]))


class BatchedLevenbergMarquardt:
    """Solver of one problem from many points.

    Args:
        problem: Runs and parameters.
        runs: Number of true runs; the rest of the batch is padding.
        whitening: Of the residuals; the problem's own weights where none is given.
        active: False for runs that do not count, shape (runs,).
        settings: Decision numbers.
    """

    def __init__(
        self,
        problem: Problem,
        runs: int,
        whitening: Whitening | None = None,
        active: np.ndarray | None = None,
        settings: BatchedSolverSettings = BATCHED_SETTINGS,
    ):
        self.problem = problem
        self.runs = runs
        self.whitening = whitening
        self.settings = settings
        weight = np.asarray(problem.batch.observed.weight)
        self.counts = weight > 0
        if active is not None:
            self.counts &= active[:, None, None]
        self.shared, self.own = len(problem.shared), len(problem.own)
        size = max(1, weight.size * (self.shared + self.own + 1) * 8)
        # Powers, so that few programs are compiled as what is free comes and goes.
        fitting = max(1.0, chunk_bytes(CHUNK_BYTES) / size)
        self.chunk = CHUNK_GROWTH ** math.floor(math.log(fitting, CHUNK_GROWTH))

    @property
    def parameters(self) -> list[Parameter]:
        """Parameter of each coordinate."""
        return [*self.problem.shared, *self.problem.own * self.runs]

    def start(self) -> np.ndarray:
        """Return the point that the problem starts from."""
        return self.flat(self.problem.start())

    def flat(self, coordinates: Coordinates) -> np.ndarray:
        """Return coordinates in one row, padded runs left out."""
        shared, own = map(np.asarray, coordinates)
        return np.r_[shared, own[: self.runs].ravel()]

    def coordinates(self, point: np.ndarray) -> Coordinates:
        """Return coordinates as the problem takes them, from one row."""
        shared, own = self._coordinates(point[None])
        return self.problem.on_all_devices((shared[0], own[0]))

    def run(
        self,
        points: np.ndarray,
        held: np.ndarray | None = None,
        shift: np.ndarray | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> BatchedSolution:
        """Minimise the sum of squares from every point.

        Args:
            points: Where to start, shape (points, coordinates).
            held: True for coordinates that stay, shape (coordinates,).
            shift: Added to every whitened residual, shape (points, runs, channels, samples).
            progress: Called with the number of the step and of points that still move.
        """
        numbers = self.settings
        free = jnp.asarray(np.ones(points.shape[1], bool) if held is None else ~held)
        descent = levenberg_marquardt(numbers.first_damping, numbers.damping_factor)
        here = points.copy()
        count = float(self.counts.sum())
        at = self._equations(here, shift)
        settled = ~np.isfinite(at.loss)
        size, state = descent.begin(_finite(at))
        rejected = np.zeros(len(here), int)
        for number in range(1, numbers.max_steps + 1):
            moving = np.flatnonzero(~settled)
            if progress:
                progress(number, len(moving))
            if not len(moving):
                break
            begun = _finite(at)
            moves = descent.next_move(begun, size, free, jnp.asarray(numbers.longest_step))
            tried = here + np.asarray(moves)
            fresh = self._equations(tried[moving], None if shift is None else shift[moving])
            ends = np.full(len(here), np.inf)
            ends[moving] = fresh.loss
            counts, size, state = descent.judge(begun, moves, jnp.asarray(ends), state)
            for place, point in enumerate(moving):
                # Whether it counts by a hair is the trust region's word, whether it gains is ours.
                gain = at.loss[point] - ends[point]
                if not (counts[point] and gain > 0):
                    rejected[point] += 1
                    settled[point] = rejected[point] == numbers.max_rejections
                    continue
                settled[point] = gain * count <= numbers.small_gain * ends[point]
                here[point], rejected[point] = tried[point], 0
                for whole, part in zip(at, fresh, strict=True):
                    whole[point] = part[place]
        return BatchedSolution(here, 2 * np.asarray(at.loss), settled & np.isfinite(at.loss))

    def _equations(self, points: np.ndarray, shift: np.ndarray | None) -> NormalEquations:
        """Return the normal equations of every point, the priors included."""
        size = points.shape[1]
        loss = np.full(len(points), np.inf)
        information, slope = np.zeros((len(points), size, size)), np.zeros((len(points), size))
        for begin in range(0, len(points), self.chunk):
            part = points[begin : begin + self.chunk]
            # One size of chunk is compiled once; the last is filled up.
            filled = np.concatenate(
                [part, part[:1].repeat(self._padded_size(len(points)) - len(part), 0)]
            )
            residuals, blocks = map(np.asarray, _blocks_at(self.problem, self._coordinates(filled)))
            for index in range(len(part)):
                number = begin + index
                extra = None if shift is None else shift[number]
                ends = self._normal(residuals[index], blocks[index], points[number], extra)
                if ends is not None:
                    loss[number], information[number], slope[number] = ends
        return NormalEquations(loss / 2, slope, information)

    def _padded_size(self, points: int) -> int:
        """Return how many points the program for so many takes; each such size is compiled once."""
        size = 1
        while size < min(points, self.chunk):
            size *= CHUNK_GROWTH
        return min(self.chunk, size)

    def _normal(
        self, residual: np.ndarray, blocks: np.ndarray, point: np.ndarray, shift: np.ndarray | None
    ) -> tuple[float, np.ndarray, np.ndarray] | None:
        """Return loss, J^T J and J^T r at one point; None where it cannot be simulated."""
        residual = np.where(self.counts, residual, 0)
        blocks = np.where(self.counts[..., None], blocks, 0)
        if not (np.isfinite(residual).all() and np.isfinite(blocks).all()):
            return None
        if self.whitening is not None:
            residual, blocks = self.whitening.apply(residual), self.whitening.apply(blocks)
        if shift is not None:
            residual = residual + shift
        information, slope = normal_equations(blocks[: self.runs], self.shared, residual)
        prior, prior_slope = self._priors(point)
        information += np.diag(prior_slope**2)
        slope += prior_slope * prior
        return float(np.sum(residual**2) + np.sum(prior**2)), information, slope

    def _priors(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the priors' residuals and their slopes, by coordinate."""
        values = [
            (float(p.prior_residual(at)), float(p.bijector.slope(at)) / float(p.prior_error))
            if np.isfinite(p.prior_error)
            else (0.0, 0.0)
            for p, at in zip(self.parameters, jnp.asarray(point), strict=True)
        ]
        prior, slope = zip(*values, strict=True) if values else ((), ())
        return np.array(prior), np.array(slope)

    def _coordinates(self, points: np.ndarray) -> Coordinates:
        rows = self.counts.shape[0]
        own = np.zeros((len(points), rows, self.own))
        own[:, : self.runs] = points[:, self.shared :].reshape(len(points), self.runs, self.own)
        # Padded runs repeat the first.
        own[:, self.runs :] = own[:, :1]
        return jnp.asarray(points[:, : self.shared]), jnp.asarray(own)


def _finite(equations: NormalEquations) -> NormalEquations:
    """Return the equations with those of points without any, which do not move, made harmless."""
    return NormalEquations(
        *(jnp.asarray(np.where(np.isfinite(each), each, 0)) for each in equations)
    )
