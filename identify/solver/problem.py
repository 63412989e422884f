"""Weighted residuals of a batch, their Jacobian and the normal equations."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from drftjax.recorded.batch import Batch, PaddedObservations, Values, between_rows, map_over_runs
from drftjax.simulation.trial import Trial
from identify.parameters.parameter import Parameter


class Problem(eqx.Module):
    """Weighted residuals of a batch as a function of coordinates, with their exact derivative.

    `predicted`, `residual` and `blocks` are programs of their own: what calls them in a program
    traces the simulation no second time.

    Attributes:
        batch: Trials and recordings.
        parameters: What is fitted.
        correlation: Share of the last sample's residual that a sample carries on [-], taken off
            before it counts.
        mesh: Devices that share the runs.
    """

    batch: Batch
    parameters: tuple[Parameter, ...]
    correlation: Float[Array, " channels"]
    mesh: Mesh = eqx.field(static=True)

    @property
    def shared(self) -> tuple[Parameter, ...]:
        return tuple(each for each in self.parameters if each.shared)

    @property
    def own(self) -> tuple[Parameter, ...]:
        return tuple(each for each in self.parameters if not each.shared)

    def start(self) -> tuple[Float[Array, " shared"], Float[Array, "runs own"]]:
        """Coordinates of the trials as they stand; shared ones from the first run."""

        def coordinates(parameters: tuple[Parameter, ...], trials: Trial) -> Array:
            columns = [jax.vmap(p.coordinate)(trials) for p in parameters]
            runs = trials.time.shape[0]
            return jnp.stack(columns, axis=1) if columns else jnp.zeros((runs, 0))

        shared = coordinates(self.shared, self.batch.trials)[0]
        return self.on_all_devices((shared, coordinates(self.own, self.batch.trials)))

    def on_all_devices(self, values: Values) -> Values:
        """`values` on every device; where they lie is part of what a program is compiled for."""
        return eqx.filter_shard(values, NamedSharding(self.mesh, PartitionSpec()))

    def trial_at(
        self, trial: Trial, shared: Float[Array, " shared"], own: Float[Array, " own"]
    ) -> Trial:
        """One run's trial with the parameters' values put in."""
        for parameter, coordinate in zip(
            self.shared + self.own, jnp.concatenate([shared, own]), strict=True
        ):
            trial = parameter.quantity.write(trial, parameter.bijector.value(coordinate))
        return trial

    def prior_residuals(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> tuple[Float[Array, " shared"], Float[Array, "runs own"]]:
        """Residuals of the priors, shaped like the coordinates; zero where there is none."""
        true_run = (jnp.arange(own.shape[0]) < self.batch.runs).astype(own.dtype)

        def of(parameters: tuple[Parameter, ...], values: Array) -> Array:
            if not parameters:
                return values
            columns = [p.prior_residual(values[..., k]) for k, p in enumerate(parameters)]
            return jnp.stack(columns, axis=-1)

        return of(self.shared, shared), of(self.own, own) * true_run[:, None]

    @eqx.filter_jit
    def prediction(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> Float[Array, "runs channels samples"]:
        """Simulated channels at the recorded times [m, N, N m]."""

        def one(trial: Trial, observed: PaddedObservations, shared: Array, own: Array) -> Array:
            return self._predict_one(trial, observed, shared, own, observed.all_rows)

        return self._over_runs(one, shared, own)

    @eqx.filter_jit
    def residual(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> Float[Array, "runs channels samples"]:
        """(Simulated minus recorded) / noise, whitened; zero where nothing was recorded."""
        return self._over_runs(self._residual_one, shared, own)

    @eqx.filter_jit
    def blocks(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> tuple[Float[Array, "runs channels samples"], Float[Array, "runs channels samples all"]]:
        """Residuals, and their derivative by (shared, this run's own) coordinates.

        No run depends on another's own parameters, so as many forward sweeps as one run has
        parameters give the whole Jacobian of any number of runs.
        """

        def one(trial: Trial, observed: PaddedObservations, shared: Array, own: Array):
            def joint(both: Array) -> tuple[Array, Array]:
                residual = self._residual_one(
                    trial, observed, both[: len(self.shared)], both[len(self.shared) :]
                )
                return residual, residual

            derivative, residual = jax.jacfwd(joint, has_aux=True)(jnp.concatenate([shared, own]))
            return residual, derivative

        return self._over_runs(one, shared, own)

    def ar1_coefficients(self, observed: PaddedObservations) -> Float[Array, "channels samples"]:
        """Share of the last sample's residual that each carries on [-]: the less, the later."""
        counts = observed.weight > 0
        follows = jnp.pad(counts[:, :-1], ((0, 0), (1, 0))) & counts
        return jnp.where(follows, self.correlation[:, None] ** observed.intervals, 0)

    def _predict_one(
        self,
        trial: Trial,
        observed: PaddedObservations,
        shared: Array,
        own: Array,
        rows: Int[Array, ""],
    ) -> Array:
        table = self.trial_at(trial, shared, own).run_to(rows, self.batch.channels)
        return between_rows(table, observed)

    def _residual_one(
        self, trial: Trial, observed: PaddedObservations, shared: Array, own: Array
    ) -> Array:
        simulated = self._predict_one(trial, observed, shared, own, observed.compared_rows)
        raw = observed.weight * (simulated - observed.values)
        before = jnp.pad(raw[:, :-1], ((0, 0), (1, 0)))
        carried = self.ar1_coefficients(observed)
        return jnp.where(carried > 0, (raw - carried * before) / jnp.sqrt(1 - carried**2), raw)

    def _over_runs(self, one, shared: Array, own: Array):
        return map_over_runs(self.batch, self.mesh, one, shared, own)


Coordinates = tuple[Float[Array, " shared"], Float[Array, "runs own"]]


def coordinates_of(run: int, number: int, shared: int) -> np.ndarray:
    """Places of a run's `number` coordinates, shared ones first, among those of all runs."""
    own = number - shared
    return np.r_[0:shared, shared + run * own : shared + (run + 1) * own]


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
        place = coordinates_of(run, shared + own, shared)
        rows = blocks[run].reshape(-1, shared + own)
        information[np.ix_(place, place)] += rows.T @ rows
        slope[place] += rows.T @ residual[run].ravel()
    return information, slope


def predict(problem: Problem, coordinates: Coordinates) -> np.ndarray:
    """Simulated channels of every run at its recorded times [m, N, N m]."""
    return np.asarray(problem.prediction(*coordinates))


def linearize(problem: Problem, coordinates: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Weighted residuals of every run, and their derivative by (shared, own) coordinates."""
    residual, blocks = problem.blocks(*coordinates)
    return np.asarray(residual), np.asarray(blocks)
