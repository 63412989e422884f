"""Where a fit ended: what profiles, bootstraps and questions about other runs go on from."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.command_knots import simplify_command
from identify.parameters.parameter import Parameter
from identify.solver.levenberg_marquardt import Solution
from identify.solver.problem import Coordinates, Problem
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import between_run_variance, covariance, per_run_steps


@dataclass(frozen=True, eq=False)
class Estimate:
    """A solved problem, and the scatter of its residuals.

    Attributes:
        problem: Runs and parameters, with the weights of the last solve.
        solution: Where the solver stopped.
        runs: The runs; the batch may hold more, which weigh nothing.
        model_error: What the simulation may be off by [m, N, N m]; see `Estimate.of`.
        left: What is left of the residuals where each run has its own zeta, if they share one: it
            scatters, and the rest is noise. Shaped like the solution's residuals.
        whitening: Of that.
        scatter: Variance of each shared coordinate from run to run; zero where it is none of sand;
            shape (shared,).
        covariance: Of all coordinates: shared, then each run's own, padded runs too.
        share: What turns the runs' slope into what they tell, shaped like `covariance`, where
            there are priors; see `identify.uncertainty.priors`.
    """

    problem: Problem
    solution: Solution
    runs: tuple[PreparedRun, ...]
    model_error: Mapping[str, float]
    noise_residual: np.ndarray
    whitening: Whitening
    run_variance: np.ndarray
    covariance: np.ndarray
    slope_rescaling: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        problem: Problem,
        solution: Solution,
        runs: tuple[PreparedRun, ...],
        model_error: Mapping[str, float],
    ) -> "Estimate":
        """Covariance and whitening of a solved problem.

        Args:
            problem, solution, runs: See `Estimate`.
            model_error: Standard deviation of a constant that the simulation may be off by over a
                phase of the command, by channel [m, N, N m].
        """
        counts = (np.asarray(problem.batch.observed.weight) > 0) & solution.active[:, None, None]
        offset = _offset(problem, model_error)
        phases = phases_of(runs, counts)
        intervals = np.asarray(problem.batch.observed.intervals)
        shared, blocks = len(problem.shared), solution.blocks
        # Sand is never the same twice; what is built stays as it is.
        sands = [place for place, each in enumerate(problem.shared) if each.quantity.is_zeta]
        alone = [*sands, *range(shared, blocks.shape[-1])]
        left = solution.residual
        moves = np.zeros((len(blocks), len(alone)))
        if sands:
            moves, left = per_run_steps(blocks, left, alone)
        whitening = Whitening.of(left, counts, offset, phases, intervals, problem.noise)
        scatter = np.zeros(shared)
        scatter[sands] = between_run_variance(moves, blocks[..., alone], whitening, len(sands))
        spread = covariance(blocks, whitening, shared, scatter)
        return cls(problem, solution, runs, model_error, left, whitening, scatter, spread)

    @property
    def shared(self) -> int:
        """Number of shared coordinates."""
        return len(self.problem.shared)

    @property
    def own(self) -> int:
        """Number of each run's own coordinates."""
        return len(self.problem.own)

    @property
    def coordinate_parameters(self) -> list[tuple[Parameter, int | None]]:
        """The parameter of each coordinate, and whose run it is; padded runs left out."""
        of_runs = [(p, r) for r in range(len(self.runs)) for p in self.problem.own]
        return [*((p, None) for p in self.problem.shared), *of_runs]

    @property
    def labels(self) -> tuple[str, ...]:
        """A name for each coordinate: "lambda", "zeta of slow_a"."""
        return tuple(
            p.quantity.label if run is None else f"{p.quantity.label} of {self.runs[run].name}"
            for p, run in self.coordinate_parameters
        )

    @property
    def flat(self) -> np.ndarray:
        """All coordinates in one row, padded runs left out."""
        shared, own = map(np.asarray, self.solution.coordinates)
        return np.r_[shared, own[: len(self.runs)].ravel()]

    def coordinates(self, flat: np.ndarray) -> Coordinates:
        """Coordinates as the problem takes them, from one row."""
        filled = np.array(self.solution.coordinates[1])
        filled[: len(self.runs)] = flat[self.shared :].reshape(-1, self.own)
        return self.problem.on_all_devices((jnp.asarray(flat[: self.shared]), jnp.asarray(filled)))

    def values(self, flat: np.ndarray) -> np.ndarray:
        """Parameters' values at these coordinates, the last axis of any shape before it."""
        columns = [
            np.asarray(p.bijector.value(jnp.asarray(flat[..., k])))
            for k, (p, _) in enumerate(self.coordinate_parameters)
        ]
        return np.stack(columns, axis=-1) if columns else np.zeros(flat.shape)

    @property
    def slopes(self) -> np.ndarray:
        """Derivative of each value by its coordinate."""
        at = jnp.asarray(self.flat)
        return np.array(
            [float(p.bijector.slope(at[k])) for k, (p, _) in enumerate(self.coordinate_parameters)]
        )

    @property
    def covariance_of_values(self) -> np.ndarray:
        """Covariance of the values, in their units squared, ordered as `labels`."""
        size = len(self.coordinate_parameters)
        slopes = self.slopes
        return slopes[:, None] * self.covariance[:size, :size] * slopes


def _offset(problem: Problem, model_error: Mapping[str, float]) -> np.ndarray:
    """Weighted residual that the simulation's own error makes, held over a phase."""
    observed = problem.batch.observed
    error = jnp.asarray([model_error.get(channel, 0.0) for channel in problem.batch.channels])
    return np.asarray(jax.vmap(problem.whiten)(observed.weight * error[:, None], observed))


def phases_of(runs: tuple[PreparedRun, ...], counts: np.ndarray) -> np.ndarray:
    """Number of the phase of the command (a straight piece of it) that each sample falls in."""
    phases = np.zeros((counts.shape[0], counts.shape[2]), int)
    for index, each in enumerate(runs):
        knots = np.asarray(simplify_command(each.setup.command).time)
        time = each.observation.time + knots[0]
        phases[index, : len(time)] = np.searchsorted(knots, time, side="right")
    return phases
