"""Least squares over a batch: optimistix's Levenberg-Marquardt on a structured Jacobian."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from identify.solver.problem import Coordinates, Problem, normal_equations
from identify.solver.settings import SOLVER_SETTINGS, SolverSettings


@dataclass(frozen=True)
class Solution:
    """End of a solve.

    Attributes:
        coordinates: Shared coordinates, shape (shared,), and each run's own, shape (runs, own).
        residual: Weighted residuals there, shape (runs, channels, samples).
        blocks: Their derivative, shape (runs, channels, samples, shared + own).
        prior_residual: Of all coordinates: shared, then each run's own, shape (coordinates,).
        prior_slope: Its derivative, each by its own coordinate, likewise.
        steps: Steps taken.
        status: "converged", "stalled" or "out of steps".
        predicted_gain: Share of the sum of squares that the linearised problem could still gain.
        active: False for runs that were put aside because their simulation diverged, shape
            (runs,). They count no more; their own coordinates stay where they last were simulated.
    """

    coordinates: Coordinates
    residual: np.ndarray
    blocks: np.ndarray
    prior_residual: np.ndarray
    prior_slope: np.ndarray
    steps: int
    status: str
    predicted_gain: float
    active: np.ndarray

    @property
    def loss(self) -> float:
        """Sum of squared weighted residuals, those of the priors included."""
        return float(np.sum(self.residual**2) + np.sum(self.prior_residual**2))


def solve(
    problem: Problem,
    start: Coordinates,
    progress: Callable[[int, float], None] | None = None,
    active: np.ndarray | None = None,
    least_gain: float | None = None,
    settings: SolverSettings = SOLVER_SETTINGS,
) -> Solution:
    """Minimise the sum of squared weighted residuals, a compiled step at a time.

    Args:
        problem: Batch and parameters.
        start: Coordinates to start from.
        progress: Called with the number of the step and the sum of squares so far.
        active: False for runs that do not count.
        least_gain: Gain [residual variances] below which steps have converged, if another than that
            of the settings.
        settings: Decision numbers.
    """
    least_gain = settings.small_gain if least_gain is None else least_gain
    report = progress or (lambda step, loss: None)
    counted = (np.asarray(problem.batch.observed.weight) > 0).sum(axis=(1, 2))
    active = np.ones(len(counted), bool) if active is None else active.copy()
    moving = active.copy()
    failures = np.zeros(len(counted), int)

    def restarted() -> tuple:
        task = problem, problem.on_all_devices(jnp.asarray(moving))
        return task, _initial(task, coordinates), np.inf, np.full(len(counted), np.inf), 0

    coordinates, ahead, status, number = start, None, "out of steps", 0
    # Places at which runs were held for the others' sake.
    parted: list[Coordinates] = []
    task, state, loss, each, rejected = restarted()
    shortened = False
    for number in range(1, settings.max_steps + 1):
        tried = state.y_eval
        coordinates, state, now, each_now, each_next = _step(task, coordinates, state)
        now, each_now = float(now), np.asarray(each_now)
        report(number, now)
        if now < loss:
            if _gain(each, each_now, counted) <= least_gain:
                status = "converged"
                break
            promised = _gain(each_now, np.asarray(each_next), counted)
            move = _longest_move(coordinates, state.y_eval)
            if not shortened and promised <= least_gain and move <= settings.short_move:
                # So short a step is taken by the linearisation, without a simulation.
                ahead, status = state.y_eval, "converged"
                break
            loss, each, rejected = now, each_now, 0
            continue
        # From here on steps are damped, and promise little because they are short.
        shortened = True
        simulated, each_tried = map(np.asarray, _tried(task, tried))
        if not all(np.isfinite(part).all() for part in state.y_eval):
            simulated = simulated & np.asarray(_differentiated(task, coordinates))
        failures = np.where(moving & ~simulated, failures + 1, 0)
        if failures.any():
            if failures.max() < settings.max_failures:
                continue
            active &= failures < settings.max_failures
            moving &= active
        else:
            rejected += 1
            if rejected < settings.max_rejections:
                continue
            least = least_gain * loss / max(counted[moving].sum(), 1)
            nearer = _part_of_step(task, coordinates, state, loss - least, settings)
            if nearer is not None:
                coordinates = nearer
                task, state, loss, each, rejected = restarted()
                shortened = False
                continue
            rough = moving & (each_tried > each)
            others = moving & ~rough
            gain = _gain(each[others], each_tried[others], counted[others])
            # Of shared numbers alone no run may be held: what one loses, others gain.
            if not problem.own or not rough.any() or gain <= settings.held_gain:
                status = "stalled"
                break
            parted.append(coordinates)
            moving = others
        if not moving.any():
            status = "stalled"
            break
        task, state, loss, each, rejected = restarted()
        shortened = False
    if (active != moving).any() or not np.isfinite(loss):
        # The solver has not been at this place with all these runs.
        task = problem, problem.on_all_devices(jnp.asarray(active))
        stands = [(at, *_step(task, at, _initial(task, at))[1:3]) for at in (coordinates, *parted)]
        best = min(stands, key=lambda each: np.nan_to_num(float(each[2]), nan=np.inf))
        if best is not stands[0]:
            ahead, status = None, "stalled"
        coordinates, state, _ = best
    ends = _ending(coordinates, ahead or coordinates, state)
    residual, blocks, prior, prior_slope = map(np.asarray, ends)
    coordinates = ahead or coordinates
    predicted_gain, _ = _whole_step(problem, residual, blocks, prior, prior_slope)
    if status == "stalled" and predicted_gain < settings.negligible:
        status = "converged"
    return Solution(
        coordinates, residual, blocks, prior, prior_slope, number, status, predicted_gain, active
    )


def _gain(before: np.ndarray, now: np.ndarray, counted: np.ndarray) -> float:
    """Return a step's gain, each run's in its residual variances: no bad fit outweighs others."""
    variance = np.maximum(now, np.finfo(float).tiny) / np.maximum(counted, 1)
    return float(np.sum(np.where(counted > 0, np.abs(before - now) / variance, 0)))


def _longest_move(before: Coordinates, after: Coordinates) -> float:
    """Return the largest change of a coordinate [-]."""
    moves = [np.abs(np.asarray(b - a)).max(initial=0.0) for a, b in zip(before, after, strict=True)]
    return float(max(moves))


def _whole_step(
    problem: Problem,
    residual: np.ndarray,
    blocks: np.ndarray,
    prior: np.ndarray,
    prior_slope: np.ndarray,
) -> tuple[float, np.ndarray]:
    """Return the predicted gain of the whole Gauss-Newton step, and the step.

    Arguments as in `Solution`.

    Returns:
        Share of the sum of squares [-], and the step of all coordinates, shape (coordinates,).
    """
    information, slope = normal_equations(blocks, len(problem.shared), residual)
    information += np.diag(prior_slope**2)
    slope += prior_slope * prior
    step = -np.linalg.lstsq(information, slope, rcond=None)[0]
    whole = max(np.sum(residual**2), np.finfo(float).tiny)
    return float(-slope @ step / whole), step


def _part_of_step(
    task: "Task", coordinates: Coordinates, state, under: float, settings: SolverSettings
) -> Coordinates | None:
    """Return a place along the whole step where the sum of squares is `under` so much.

    None where there is none, or the predicted gain is negligible.
    """
    problem, _ = task
    residual, blocks, prior, prior_slope = map(np.asarray, _ending(coordinates, coordinates, state))
    predicted_gain, step = _whole_step(problem, residual, blocks, prior, prior_slope)
    if predicted_gain < settings.negligible:
        return None
    shared, own = coordinates
    number = len(problem.shared)
    for part in settings.step_parts:
        there = problem.on_all_devices(
            (shared + part * step[:number], own + part * step[number:].reshape(own.shape))
        )
        # Not finite, so not under, where a run cannot be simulated.
        if float(_loss(task, there)) < under:
            return there
    return None


_SOLVER = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12, linear_solver=lx.QR())


# A problem, and which of its runs count.
Task = tuple[Problem, Bool[Array, " runs"]]


def _function(coordinates: Coordinates, task: Task) -> tuple[tuple[Array, ...], None]:
    problem, _ = task
    return (structured_residual(task, coordinates), *problem.prior_residuals(*coordinates)), None


@eqx.filter_jit
def _initial(task: Task, start: Coordinates):
    shape, nothing = jax.eval_shape(_function, start, task)
    state = _SOLVER.init(_function, start, task, {}, shape, nothing, frozenset())
    return task[0].on_all_devices(state)


@eqx.filter_jit
def _step(task: Task, coordinates: Coordinates, state):
    coordinates, state, _ = _SOLVER.step(_function, coordinates, task, {}, state, frozenset())
    coordinates, state = task[0].on_all_devices((coordinates, state))
    residual, *priors = state.f_info.residual
    each = jnp.sum(residual**2, axis=(1, 2))
    loss = each.sum() + sum(jnp.sum(part**2) for part in priors)
    # Sum of squares of each run that the linearisation predicts after the next step, known already.
    ahead = jax.tree.map(jnp.subtract, state.y_eval, coordinates)
    predicted_gain, *_ = state.f_info.jac.mv(ahead)
    return coordinates, state, loss, each, jnp.sum((residual + predicted_gain) ** 2, axis=(1, 2))


@eqx.filter_jit
def _tried(task: Task, tried: Coordinates) -> tuple[Bool[Array, " runs"], Float[Array, " runs"]]:
    """Return which runs can be simulated at `tried`, and each run's sum of squares there."""
    residual = task[0].residual(*tried)
    return _finite(residual), jnp.sum(residual**2, axis=(1, 2))


@eqx.filter_jit
def _loss(task: Task, at: Coordinates) -> Float[Array, ""]:
    """Return the sum of squares of the runs that count, and of the priors."""
    residual, *priors = _function(at, task)[0]
    return jnp.sum(residual**2) + sum(jnp.sum(part**2) for part in priors)


@eqx.filter_jit
def _differentiated(task: Task, coordinates: Coordinates) -> Bool[Array, " runs"]:
    """Return which runs can be differentiated at these coordinates."""
    return _finite(task[0].blocks(*coordinates)[1])


def _finite(values: Array) -> Bool[Array, " runs"]:
    return jnp.isfinite(values).all(axis=tuple(range(1, values.ndim)))


@eqx.filter_jit
def _ending(coordinates: Coordinates, ahead: Coordinates, state):
    """Return residuals and derivatives, extrapolated linearly from the solver's place to `ahead`.

    The solver's own linearisation is used; nothing is simulated.
    """
    info = state.f_info
    shared, own = coordinates
    runs, number = own.shape
    units = [
        *((unit, jnp.zeros_like(own)) for unit in jnp.eye(len(shared))),
        *((jnp.zeros_like(shared), jnp.tile(unit, (runs, 1))) for unit in jnp.eye(number)),
    ]
    blocks = jnp.stack([info.jac.mv(unit)[0] for unit in units], axis=-1)
    step = jax.tree.map(jnp.subtract, ahead, coordinates)
    residual, *priors = jax.tree.map(jnp.add, info.residual, info.jac.mv(step))
    # Each prior depends on one coordinate, so a single sweep gives every slope.
    _, *slopes = info.jac.mv(jax.tree.map(jnp.ones_like, coordinates))
    flat = [jnp.concatenate([part.ravel() for part in parts]) for parts in (priors, slopes)]
    return residual, blocks, *flat


def _counted(active: Bool[Array, " runs"], values: Array) -> Array:
    """Return `values` of each run, zero for those that do not count."""
    return jnp.where(active.reshape(-1, *[1] * (values.ndim - 1)), values, 0)


@eqx.filter_custom_jvp
def structured_residual(task: Task, coordinates: Coordinates) -> Array:
    """Return `problem.residual` of the runs that count, its derivative made of one block a run.

    The blocks are computed once, however many directions the solver asks for.
    """
    problem, active = task
    return _counted(active, problem.residual(*coordinates))


@structured_residual.def_jvp
def _structured_derivative(primals, tangents):
    (problem, active), coordinates = primals
    _, (shared_dot, own_dot) = tangents
    residual, blocks = (_counted(active, part) for part in problem.blocks(*coordinates))
    runs = residual.shape[0]
    spread = jnp.broadcast_to(shared_dot, (runs, shared_dot.shape[0]))
    along = jnp.concatenate([spread, own_dot], axis=1)
    return residual, jnp.einsum("rcsp,rp->rcs", blocks, along)
