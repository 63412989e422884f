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
# Of the sum of squares: less is not worth a warning.
NEGLIGIBLE = 0.01
MOST_STEPS = 60


@dataclass(frozen=True)
class Solution:
    """Where the solver stopped.

    Attributes:
        coordinates: Shared coordinates, and each run's own.
        residual: Weighted residuals there, shape (runs, channels, samples).
        blocks: Their derivative, shape (runs, channels, samples, shared + own).
        belief: Residuals of the priors of all coordinates: shared, then each run's own.
        belief_slope: Their derivative, each by its own coordinate.
        steps: Steps taken.
        status: "converged", "stalled" or "out of steps".
        promised: Share of the sum of squares that a straight line from here says is still to gain.
    """

    coordinates: Coordinates
    residual: np.ndarray
    blocks: np.ndarray
    belief: np.ndarray
    belief_slope: np.ndarray
    steps: int
    status: str
    promised: float


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
            status = "stalled"
            break
        loss = min(loss, now)
    residual, blocks, belief, belief_slope = map(np.asarray, _ending(problem, coordinates))
    information, slope = normal_equations(blocks, len(problem.shared), residual)
    information += np.diag(belief_slope**2)
    slope += belief_slope * belief
    promised = _promised(residual, information, slope)
    if status == "stalled" and promised < NEGLIGIBLE:
        status = "converged"
    return Solution(coordinates, residual, blocks, belief, belief_slope, number, status, promised)


def _promised(residual: np.ndarray, information: np.ndarray, slope: np.ndarray) -> float:
    """Share of the sum of squares that the derivative could still take away."""
    gain = slope @ np.linalg.lstsq(information, slope, rcond=None)[0]
    return float(gain / max(np.sum(residual**2), np.finfo(float).tiny))


def normal_equations(
    blocks: np.ndarray, shared: int, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """J^T J and J^T r of all coordinates: shared ones, then each run's own.

    Args:
        blocks: Derivatives, shape (runs, channels, samples, shared + own).
        shared: Number of shared coordinates.
        residual: Residuals, shape (runs, channels, samples).
    """
    runs, own = len(blocks), blocks.shape[-1] - shared
    size = shared + runs * own
    information, slope = np.zeros((size, size)), np.zeros(size)
    for run in range(runs):
        place = np.r_[0:shared, shared + run * own : shared + (run + 1) * own]
        rows = blocks[run].reshape(-1, shared + own)
        information[np.ix_(place, place)] += rows.T @ rows
        slope[place] += rows.T @ residual[run].ravel()
    return information, slope


_SOLVER = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12, linear_solver=lx.QR())


def _function(coordinates: Coordinates, problem: Problem) -> tuple[tuple[Array, ...], None]:
    return (structured_residual(problem, coordinates), *problem.beliefs(*coordinates)), None


@eqx.filter_jit
def _initial(problem: Problem, start: Coordinates):
    shape, nothing = jax.eval_shape(_function, start, problem)
    state = _SOLVER.init(_function, start, problem, {}, shape, nothing, frozenset())
    return problem.everywhere(state)


@eqx.filter_jit
def _step(problem: Problem, coordinates: Coordinates, state):
    coordinates, state, _ = _SOLVER.step(_function, coordinates, problem, {}, state, frozenset())
    coordinates, state = problem.everywhere((coordinates, state))
    return coordinates, state, sum(jnp.sum(part**2) for part in state.f_info.residual)


@eqx.filter_jit
def _ending(problem: Problem, coordinates: Coordinates):
    def beliefs(coordinates: Coordinates) -> Array:
        shared, own = problem.beliefs(*coordinates)
        return jnp.concatenate([shared, own.ravel()])

    ones = jax.tree.map(jnp.ones_like, coordinates)
    # Each belief bears on one coordinate, so a single sweep gives every slope.
    return *problem.blocks(*coordinates), *jax.jvp(beliefs, (coordinates,), (ones,))


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
