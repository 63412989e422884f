"""Estimate: solution of a fit with the scatter of its residuals and the covariance.

Profile likelihoods, bootstraps and predictions for other runs start from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.recorded.observation import white_noise
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.command_knots import simplify_command
from identify.parameters.parameter import Parameter
from identify.solver.levenberg_marquardt import Solution
from identify.solver.problem import Coordinates, Problem
from identify.solver.whitening import Whitening
from identify.uncertainty.covariance import between_run_variance, covariance, per_run_steps
from identify.uncertainty.model_error import MISFIT_SETTINGS, MODEL_ERROR, MisfitSettings


@dataclass(frozen=True, eq=False)
class Estimate:
    """Solution of a problem, the scatter of its residuals and the covariance.

    Attributes:
        problem: Runs and parameters, with the weights of the last solve.
        solution: End of the solve.
        runs: The runs; the batch may hold padding beyond them, of no weight.
        model_error: Constant error of the simulation over a phase, by channel and run [m, N, N m],
            shape (padded runs,) each; see `Estimate.of`.
        noise_residual: Residuals with a zeta of each run's own where the runs share one: the rest
            is a random effect. Shaped like the solution's residuals.
        whitening: Of `noise_residual`.
        run_variance: Variance of each shared coordinate from run to run; zero for all but those of
            sand; shape (shared,).
        covariance: Of all coordinates: shared, then each run's own, padded runs too, shape
            (all, all).
        slope_rescaling: Matrix that rescales the runs' slope, shaped like `covariance`, where there
            are priors; see `identify.uncertainty.priors`.
    """

    problem: Problem
    solution: Solution
    runs: tuple[PreparedRun, ...]
    model_error: Mapping[str, np.ndarray]
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
        finest: float = 0.1,
        misfit: MisfitSettings = MISFIT_SETTINGS,
    ) -> "Estimate":
        """Return the estimate of a solved problem.

        Args:
            problem, solution, runs: See `Estimate`.
            model_error: Standard deviation of a constant that the simulation may be off by over a
                phase of the command, by channel [m, N, N m].
            finest: See `Whitening`.
            misfit: From when on a run's residual is an error of the model, which takes its place.
        """
        counts = (np.asarray(problem.batch.observed.weight) > 0) & solution.active[:, None, None]
        phases = phases_of(runs, counts)
        intervals = np.asarray(problem.batch.observed.intervals)
        shared, blocks = len(problem.shared), solution.blocks
        # Sand differs from run to run; wheel and rig do not.
        sands = [place for place, each in enumerate(problem.shared) if each.quantity.is_zeta]
        moving = [*sands, *range(shared, blocks.shape[-1])]
        residual = solution.residual
        moves = np.zeros((len(blocks), len(moving)))
        if sands:
            moves, residual = per_run_steps(blocks, residual, moving)
        gaps = _with_gaps(problem, residual, counts, model_error, misfit)
        offset = _offset(problem, gaps)
        whitening = Whitening.of(residual, counts, offset, phases, intervals, problem.noise, finest)
        scatter = np.zeros(shared)
        scatter[sands] = between_run_variance(moves, blocks[..., moving], whitening, len(sands))
        spread = covariance(blocks, whitening, shared, scatter)
        return cls(problem, solution, runs, gaps, residual, whitening, scatter, spread)

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
        """Parameter and run (None where shared) of each coordinate; padded runs left out."""
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
        """All coordinates in one row, padded runs left out, shape (coordinates,)."""
        shared, own = map(np.asarray, self.solution.coordinates)
        return np.r_[shared, own[: len(self.runs)].ravel()]

    def coordinates(self, flat: np.ndarray) -> Coordinates:
        """Return coordinates as the problem takes them, from one row."""
        filled = np.array(self.solution.coordinates[1])
        filled[: len(self.runs)] = flat[self.shared :].reshape(-1, self.own)
        return self.problem.on_all_devices((jnp.asarray(flat[: self.shared]), jnp.asarray(filled)))

    def values(self, flat: np.ndarray) -> np.ndarray:
        """Return the parameters' values at coordinates of shape (..., coordinates)."""
        columns = [
            np.asarray(p.bijector.value(jnp.asarray(flat[..., k])))
            for k, (p, _) in enumerate(self.coordinate_parameters)
        ]
        return np.stack(columns, axis=-1) if columns else np.zeros(flat.shape)

    @property
    def slopes(self) -> np.ndarray:
        """Derivative of each value by its coordinate."""
        shared, own = self.solution.coordinates
        pairs = zip(self.problem.shared, shared, strict=True)
        of_shared = [float(p.bijector.slope(at)) for p, at in pairs]
        of_own = [
            p.bijector.slope(own[: len(self.runs), k]) for k, p in enumerate(self.problem.own)
        ]
        return np.r_[np.array(of_shared), np.array(of_own).T.ravel()]

    @property
    def covariance_of_values(self) -> np.ndarray:
        """Covariance of the values, in their units squared, ordered as `labels`."""
        size = len(self.coordinate_parameters)
        slopes = self.slopes
        return slopes[:, None] * self.covariance[:size, :size] * slopes


def _with_gaps(
    problem: Problem,
    residual: np.ndarray,
    counts: np.ndarray,
    model_error: Mapping[str, float],
    misfit: MisfitSettings,
) -> dict[str, np.ndarray]:
    """Return the simulation's constant error over a phase, by channel and run [m, N, N m].

    Where a run's residual is far above the noise the model is off by about as much, and no number
    of samples averages that away.
    """
    weight = np.asarray(problem.batch.observed.weight)
    raw = np.divide(residual, weight, out=np.zeros_like(residual), where=counts)
    left = np.sqrt((raw**2).sum(axis=2) / np.maximum(counts.sum(axis=2), 1))
    found = {}
    for channel, name in enumerate(problem.batch.channels):
        pairs = zip(raw[:, channel], counts[:, channel], strict=True)
        noise = np.array([white_noise(each[here]) for each, here in pairs])
        floor = np.maximum(noise, MODEL_ERROR[name])
        off = np.where(left[:, channel] > misfit.poor * floor, left[:, channel], 0.0)
        found[name] = np.hypot(model_error.get(name, 0.0), off)
    return found


def _offset(problem: Problem, model_error: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the weighted, whitened residual of the simulation's own error, held over a phase."""
    observed = problem.batch.observed
    error = jnp.asarray(np.stack([model_error[each] for each in problem.batch.channels], axis=1))
    return np.asarray(jax.vmap(problem.whiten)(observed.weight * error[:, :, None], observed))


def phases_of(runs: tuple[PreparedRun, ...], counts: np.ndarray) -> np.ndarray:
    """Return the number of the phase (a straight piece) of the command at each sample.

    Args:
        runs: The runs.
        counts: True for samples that are compared, shape (padded runs, channels, samples).

    Returns:
        Shape (padded runs, samples).
    """
    phases = np.zeros((counts.shape[0], counts.shape[2]), int)
    for index, each in enumerate(runs):
        knots = np.asarray(simplify_command(each.setup.command).time)
        time = each.observation.time + knots[0]
        phases[index, : len(time)] = np.searchsorted(knots, time, side="right")
    return phases
