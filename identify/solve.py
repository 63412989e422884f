"""Least squares over a batch: optimistix's Levenberg-Marquardt on a structured Jacobian."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from identify.batch import Problem

Coordinates = tuple[Float[Array, " shared"], Float[Array, "runs own"]]

# A step that lowers the sum of squares by less than this many residual variances moves no
# parameter by a noticeable part of its standard error.
LEAST_GAIN = 0.1
# After so many refusals in a row, each a shorter step than the last, what is left to gain lies
# under the simulation's resolution: stops and landings make the sum of squares rough by as much.
MOST_REFUSED = 3
MOST_STEPS = 60


@dataclass(frozen=True)
class Solution:
    """Where the solver stopped.

    Attributes:
        coordinates: Shared coordinates, and each run's own.
        residual: Weighted residuals there, shape (runs, channels, samples).
        blocks: Their derivative, shape (runs, channels, samples, shared + own).
        steps: Steps taken.
        status: "converged", "stalled" (no step was accepted at all) or "out of steps".
    """

    coordinates: Coordinates
    residual: np.ndarray
    blocks: np.ndarray
    steps: int
    status: str


def solve(
    problem: Problem, start: Coordinates, progress: Callable[[int, float], None] | None = None
) -> Solution:
    """Minimise the sum of squared weighted residuals, a compiled step at a time.

    Args:
        problem: Batch and parameters.
        start: Coordinates to start from.
        progress: Called with the number of the step and the sum of squares so far.
    """
    report = progress or (lambda step, loss: None)
    counted = int((problem.batch.observed.weight > 0).sum())
    coordinates, state = start, _initial(problem, start)
    loss, refused, status, number = np.inf, 0, "out of steps", 0
    for number in range(1, MOST_STEPS + 1):
        coordinates, state, now = _step(problem, coordinates, state)
        now = float(now)
        report(number, now)
        accepted = now < loss
        refused = 0 if accepted else refused + 1
        if accepted and (loss - now) * counted <= LEAST_GAIN * now:
            status = "converged"
            break
        if refused == MOST_REFUSED:
            status = "converged" if number > 1 + refused else "stalled"
            break
        loss = min(loss, now)
    residual, blocks = _blocks(problem, coordinates)
    return Solution(coordinates, np.asarray(residual), np.asarray(blocks), number, status)


_SOLVER = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12, linear_solver=lx.QR())


def _function(coordinates: Coordinates, problem: Problem) -> tuple[Array, None]:
    return structured_residual(problem, coordinates), None


@eqx.filter_jit
def _initial(problem: Problem, start: Coordinates):
    shape, nothing = jax.eval_shape(_function, start, problem)
    return _SOLVER.init(_function, start, problem, {}, shape, nothing, frozenset())


@eqx.filter_jit
def _step(problem: Problem, coordinates: Coordinates, state):
    coordinates, state, _ = _SOLVER.step(_function, coordinates, problem, {}, state, frozenset())
    return coordinates, state, jnp.sum(state.f_info.residual**2)


@eqx.filter_jit
def _blocks(problem: Problem, coordinates: Coordinates):
    return problem.blocks(*coordinates)


@eqx.filter_custom_jvp
def structured_residual(problem: Problem, coordinates: Coordinates) -> Array:
    """`problem.residual`, whose derivative is made of one block for each run.

    The blocks are computed once, however many directions the solver asks for.
    """
    return problem.residual(*coordinates)


@structured_residual.def_jvp
def _structured_derivative(primals, tangents):
    problem, coordinates = primals
    _, (shared_dot, own_dot) = tangents
    residual, blocks = problem.blocks(*coordinates)
    runs = residual.shape[0]
    spread = jnp.broadcast_to(shared_dot, (runs, shared_dot.shape[0]))
    along = jnp.concatenate([spread, own_dot], axis=1)
    return residual, jnp.einsum("rcsp,rp->rcs", blocks, along)
