"""Least squares over a batch: optimistix's Levenberg-Marquardt on a structured Jacobian."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from identify.solver.arrow import ArrowQR, columns, gauss_newton_step
from identify.solver.problem import Coordinates, Problem
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
    """Minimise the sum of squared weighted residuals.

    The problem simulates the runs, here or elsewhere, and gives rows and their derivatives; what a
    step makes of these is compiled apart, so the steps are the same wherever the runs are.

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
        return _Ground(problem, moving), None, np.inf, np.full(len(counted), np.inf), 0

    coordinates, ahead, status, number = start, None, "out of steps", 0
    # Places at which runs were held for the others' sake.
    parted: list[Coordinates] = []
    ground, state, loss, each, rejected = restarted()
    shortened = False
    for number in range(1, settings.max_steps + 1):
        tried = coordinates if state is None else state.y_eval
        rows = ground.rows(tried)
        coordinates, state, now, each_now, each_next = ground.step(rows, coordinates, state)
        report(number, now)
        if now < loss:
            if _gain(each, each_now, counted) <= least_gain:
                status = "converged"
                break
            promised = _gain(each_now, each_next, counted)
            move = _longest_move(coordinates, state.y_eval)
            if not shortened and promised <= least_gain and move <= settings.short_move:
                # So short a step is taken by the linearisation, without a simulation.
                ahead, status = state.y_eval, "converged"
                break
            loss, each, rejected = now, each_now, 0
            continue
        # From here on steps are damped, and promise little because they are short.
        shortened = True
        simulated = _finite(rows[0])
        each_tried = np.asarray(jnp.sum(rows[0] ** 2, axis=(1, 2)))
        if not all(np.isfinite(part).all() for part in state.y_eval):
            simulated = simulated & _finite(ground.rows(coordinates)[1])
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
            nearer = _part_of_step(ground, coordinates, state, loss - least, settings)
            if nearer is not None:
                coordinates = nearer
                ground, state, loss, each, rejected = restarted()
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
        ground, state, loss, each, rejected = restarted()
        shortened = False
    if (active != moving).any() or not np.isfinite(loss):
        # The solver has not been at this place with all these runs.
        ground = _Ground(problem, active)
        stands = [
            (at, *ground.step(ground.rows(at), at, None)[1:3]) for at in (coordinates, *parted)
        ]
        best = min(stands, key=lambda each: np.nan_to_num(each[2], nan=np.inf))
        if best is not stands[0]:
            ahead, status = None, "stalled"
        coordinates, state, _ = best
    ends = ground.ending(coordinates, ahead or coordinates, state)
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
    fall, step = gauss_newton_step(blocks, residual, prior, prior_slope, len(problem.shared))
    return fall / max(float(np.sum(residual**2)), np.finfo(float).tiny), step


def _part_of_step(
    ground: "_Ground", coordinates: Coordinates, state, under: float, settings: SolverSettings
) -> Coordinates | None:
    """Return a place along the whole step where the sum of squares is `under` so much.

    None where there is none, or the predicted gain is negligible.
    """
    problem = ground.problem
    ends = _ending(coordinates, coordinates, state)
    predicted_gain, step = _whole_step(problem, *map(np.asarray, ends))
    if predicted_gain < settings.negligible:
        return None
    shared, own = coordinates
    number = len(problem.shared)
    for part in settings.step_parts:
        there = problem.on_all_devices(
            (shared + part * step[:number], own + part * step[number:].reshape(own.shape))
        )
        # Not finite, so not under, where a run cannot be simulated.
        if ground.loss(there) < under:
            return there
    return None


_SOLVER = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12, linear_solver=ArrowQR())


# A run's rows and their derivatives at one place, of the runs that count.
Rows = tuple[Float[Array, "runs channels samples"], Float[Array, "runs channels samples all"]]


@dataclass(frozen=True)
class _Ground:
    """A problem, and which of its runs count."""

    problem: Problem
    counting: np.ndarray

    def rows(self, at: Coordinates) -> Rows:
        """Return rows and derivatives of the runs that count; zero for the others."""
        return self._counted(self.problem.rows(*at))

    def loss(self, at: Coordinates) -> float:
        """Return the sum of squares of the runs that count, and of the priors."""
        (residual,) = self._counted([self.problem.residual(*at)])
        priors = self.problem.prior_residuals(*at)
        return float(jnp.sum(residual**2) + sum(jnp.sum(part**2) for part in priors))

    def step(self, rows: Rows, coordinates: Coordinates, state) -> tuple:
        """Take a step of the solver, from the rows at the place that its state names.

        Args:
            rows: There; at `coordinates` where there is no state yet.
            coordinates: The best so far.
            state: The solver's.

        Returns:
            The best coordinates, the state, the sum of squares there, that of each run, and that
            of each run which the linearisation predicts after the next step.
        """
        if state is None:
            state = _initial(self.problem, rows, coordinates)
        coordinates, state, loss, *each = _step(self.problem, rows, coordinates, state)
        return coordinates, state, float(loss), *map(np.asarray, each)

    def ending(self, coordinates: Coordinates, ahead: Coordinates, state) -> tuple:
        """Return `_ending`, with a row for each reading where the solver had fewer."""
        residual, blocks, *priors = _ending(coordinates, ahead, state)
        if residual.shape != self.problem.batch.observed.weight.shape:
            here, blocks = self._counted(self.problem.blocks(*coordinates))
            residual = here + _along(blocks, jax.tree.map(jnp.subtract, ahead, coordinates))
        return residual, blocks, *priors

    def _counted(self, parts):
        """Return parts with a leading axis of runs, zero for those that do not count."""
        return self.problem.on_all_devices(_of_counting(jnp.asarray(self.counting), tuple(parts)))


@eqx.filter_jit
def _of_counting(counting: Bool[Array, " runs"], parts: tuple) -> tuple:
    def of(values: Array) -> Array:
        return jnp.where(counting.reshape(-1, *[1] * (values.ndim - 1)), values, 0)

    return tuple(of(jnp.asarray(each)) for each in parts)


def _function(coordinates: Coordinates, at: tuple[Problem, Rows]) -> tuple[tuple, None]:
    problem, rows = at
    return (structured_residual(rows, coordinates), *problem.prior_residuals(*coordinates)), None


@eqx.filter_jit
def _initial(problem: Problem, rows: Rows, start: Coordinates):
    at = problem, rows
    shape, nothing = jax.eval_shape(_function, start, at)
    state = _SOLVER.init(_function, start, at, {}, shape, nothing, frozenset())
    return problem.on_all_devices(state)


@eqx.filter_jit
def _step(problem: Problem, rows: Rows, coordinates: Coordinates, state):
    at = problem, rows
    coordinates, state, _ = _SOLVER.step(_function, coordinates, at, {}, state, frozenset())
    coordinates, state = problem.on_all_devices((coordinates, state))
    residual, *priors = state.f_info.residual
    each = jnp.sum(residual**2, axis=(1, 2))
    loss = each.sum() + sum(jnp.sum(part**2) for part in priors)
    # Sum of squares of each run that the linearisation predicts after the next step, known already.
    ahead = jax.tree.map(jnp.subtract, state.y_eval, coordinates)
    predicted_gain, *_ = state.f_info.jac.mv(ahead)
    return coordinates, state, loss, each, jnp.sum((residual + predicted_gain) ** 2, axis=(1, 2))


def _finite(values: Array) -> np.ndarray:
    return np.asarray(jnp.isfinite(values).reshape(len(values), -1).all(axis=1))


@eqx.filter_jit
def _ending(coordinates: Coordinates, ahead: Coordinates, state):
    """Return rows and derivatives, extrapolated linearly from the solver's place to `ahead`.

    The solver's own linearisation is used; nothing is simulated.
    """
    info = state.f_info
    blocks, *slopes = columns(info.jac.mv, coordinates)
    step = jax.tree.map(jnp.subtract, ahead, coordinates)
    residual, *priors = jax.tree.map(jnp.add, info.residual, info.jac.mv(step))
    flat = [jnp.concatenate([part.ravel() for part in parts]) for parts in (priors, slopes)]
    return residual, blocks, *flat


def _along(blocks: Array, step: Coordinates) -> Array:
    """Return the change of each run's rows along a step of (shared, own) coordinates."""
    shared, own = step
    spread = jnp.broadcast_to(shared, (len(own), len(shared)))
    return jnp.einsum("rcsp,rp->rcs", blocks, jnp.concatenate([spread, own], axis=1))


@eqx.filter_custom_jvp
def structured_residual(rows: Rows, coordinates: Coordinates) -> Array:
    """Return the rows at the place where they were evaluated, with their derivative there.

    The solver asks nowhere else; the derivative is made of one block a run.
    """
    del coordinates
    return rows[0]


@structured_residual.def_jvp
def _structured_derivative(primals, tangents):
    (residual, blocks), _ = primals
    return residual, _along(blocks, tangents[1])
