"""Weighted residuals of a batch, their Jacobian and the normal equations."""

import abc
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from drftjax.recorded.batch import Batch, PaddedObservations, Values, between_rows, map_over_runs
from drftjax.simulation.step_error import step_error
from drftjax.simulation.trial import Trial
from identify.parameters.parameter import Parameter
from identify.solver.abstract_noise import AbstractNoise


class AbstractEvaluator(abc.ABC):
    """Place where the runs of a problem are simulated; shapes as of the problem's methods."""

    @abc.abstractmethod
    def prediction(self, problem: "Problem", shared: Array, own: Array) -> Array:
        """Return `problem.prediction`."""

    @abc.abstractmethod
    def residual(self, problem: "Problem", shared: Array, own: Array) -> Array:
        """Return `problem.residual`."""

    @abc.abstractmethod
    def blocks(self, problem: "Problem", shared: Array, own: Array) -> tuple[Array, Array]:
        """Return `problem.blocks`."""

    @abc.abstractmethod
    def rows(self, problem: "Problem", shared: Array, own: Array) -> tuple[Array, Array]:
        """Return `problem.rows`."""


@dataclass(frozen=True)
class InProcess(AbstractEvaluator):
    """This process, on all devices of the problem's mesh.

    `prediction` and `blocks` are compiled programs of their own, so that a program that calls one
    of them does not trace the simulation again. A residual is made of a prediction: the few that a
    fit asks for are worth no third program with the simulation in it.
    """

    def prediction(self, problem: "Problem", shared: Array, own: Array) -> Array:
        return _prediction(problem, shared, own)

    def residual(self, problem: "Problem", shared: Array, own: Array) -> Array:
        return _residual(problem, _prediction(problem, shared, own))

    def blocks(self, problem: "Problem", shared: Array, own: Array) -> tuple[Array, Array]:
        return _blocks(problem, shared, own)

    def rows(self, problem: "Problem", shared: Array, own: Array) -> tuple[Array, Array]:
        return _blocks(problem, shared, own)


IN_PROCESS = InProcess()


class Problem(eqx.Module):
    r"""Weighted residuals of a batch as a function of coordinates, with their exact derivative.

    The residual of a sample is (simulated - recorded) / noise, whitened by the noise model:
    $r(\theta, u_1, \dots, u_R)$ with shared coordinates $\theta$ and each run's own $u$.

    Attributes:
        batch: Trials and recordings, stacked.
        parameters: Fitted parameters.
        noise: Model that whitens the residuals.
        mesh: Devices over which the runs are divided.
        prior_scale: Factor on the residuals of priors [-], less than one while the runs are
            weighted by less than their noise.
        evaluator: Place where the runs are simulated.
    """

    batch: Batch
    parameters: tuple[Parameter, ...]
    noise: AbstractNoise
    mesh: Mesh = eqx.field(static=True)
    prior_scale: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=1.0)
    evaluator: AbstractEvaluator = eqx.field(static=True, default=IN_PROCESS)

    @property
    def shared(self) -> tuple[Parameter, ...]:
        """Parameters with one value for all runs."""
        return tuple(each for each in self.parameters if each.shared)

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Parameters with one value for each run."""
        return tuple(each for each in self.parameters if not each.shared)

    def start(self) -> tuple[Float[Array, " shared"], Float[Array, "runs own"]]:
        """Return the coordinates of the trials' own values; shared ones from the first run."""

        def coordinates(parameters: tuple[Parameter, ...], trials: Trial) -> Array:
            columns = [jax.vmap(p.coordinate)(trials) for p in parameters]
            runs = trials.time.shape[0]
            return jnp.stack(columns, axis=1) if columns else jnp.zeros((runs, 0))

        shared = coordinates(self.shared, self.batch.trials)[0]
        return self.on_all_devices((shared, coordinates(self.own, self.batch.trials)))

    def on_all_devices(self, values: Values) -> Values:
        """Return `values` on every device: a program is compiled for the place of its arguments."""
        return eqx.filter_shard(values, NamedSharding(self.mesh, PartitionSpec()))

    def trial_at(
        self, trial: Trial, shared: Float[Array, " shared"], own: Float[Array, " own"]
    ) -> Trial:
        """Return one run's trial with the values of the parameters at these coordinates."""
        for parameter, coordinate in zip(
            self.shared + self.own, jnp.concatenate([shared, own]), strict=True
        ):
            trial = parameter.quantity.write(trial, parameter.bijector.value(coordinate))
        return trial

    def prior_residuals(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> tuple[Float[Array, " shared"], Float[Array, "runs own"]]:
        """Return (value - prior mean) / prior error of each coordinate; zero without a prior."""
        true_run = (jnp.arange(own.shape[0]) < self.batch.runs).astype(own.dtype)

        def of(parameters: tuple[Parameter, ...], values: Array) -> Array:
            if not parameters:
                return values
            columns = [p.prior_residual(values[..., k]) for k, p in enumerate(parameters)]
            return self.prior_scale * jnp.stack(columns, axis=-1)

        return of(self.shared, shared), of(self.own, own) * true_run[:, None]

    def without_step_error(self, coordinates: "Coordinates") -> "Problem":
        """Return the problem whose simulated channels are those of far shorter steps.

        Their difference at these coordinates is taken off at all others; derivatives remain those
        of the runs' own steps.
        """
        trials, observed = self.batch.trials, self.batch.observed
        plain = eqx.tree_at(
            lambda p: p.batch.observed.step_error, self, jnp.zeros_like(observed.step_error)
        )

        def simulated(parts: np.ndarray) -> np.ndarray:
            finer = jnp.asarray(parts, trials.parts.dtype)
            return predict(eqx.tree_at(lambda p: p.batch.trials.parts, plain, finer), coordinates)

        error = jnp.asarray(step_error(simulated, trials))
        return eqx.tree_at(lambda p: p.batch.observed.step_error, plain, error)

    def prediction(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> Float[Array, "runs channels samples"]:
        """Return the simulated channels at the recorded times [m, N, N m]."""
        return self.evaluator.prediction(self, shared, own)

    def residual(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> Float[Array, "runs channels samples"]:
        """Return the weighted, whitened residuals [-]; zero where nothing is compared."""
        return self.evaluator.residual(self, shared, own)

    def blocks(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> tuple[Float[Array, "runs channels samples"], Float[Array, "runs channels samples all"]]:
        """Return the residuals, and their derivative by (shared, this run's own) coordinates.

        No run depends on another run's own parameters: as many forward sweeps as one run has
        parameters give the whole Jacobian of any number of runs.
        """
        return self.evaluator.blocks(self, shared, own)

    def rows(
        self, shared: Float[Array, " shared"], own: Float[Array, "runs own"]
    ) -> tuple[Float[Array, "runs channels rows"], Float[Array, "runs channels rows all"]]:
        """Return residuals and derivatives as the solver takes them.

        Their normal equations are those of `blocks`; where the runs are simulated elsewhere there
        are only as many rows a run as these need.
        """
        return self.evaluator.rows(self, shared, own)

    def whiten(
        self, weighted: Float[Array, "channels samples"], observed: PaddedObservations
    ) -> Float[Array, "channels samples"]:
        """Return one run's weighted residuals, whitened by the noise model."""
        return self.noise.whiten(weighted, sample_gaps(observed))

    def predict_one(
        self,
        trial: Trial,
        observed: PaddedObservations,
        shared: Array,
        own: Array,
        rows: Int[Array, ""],
    ) -> Array:
        """Return one run's channels, simulated up to this row."""
        table = self.trial_at(trial, shared, own).run_to(rows, self.batch.channels)
        return between_rows(table, observed)

    def residual_one(
        self, trial: Trial, observed: PaddedObservations, shared: Array, own: Array
    ) -> Array:
        """Return one run's weighted, whitened residuals."""
        simulated = self.predict_one(trial, observed, shared, own, observed.compared_rows)
        return self.weighted(simulated, observed)

    def weighted(self, simulated: Array, observed: PaddedObservations) -> Array:
        """Return the weighted, whitened residuals of one run's simulated channels."""
        return self.whiten(observed.weight * (simulated - observed.values), observed)


@eqx.filter_jit
def _prediction(problem: Problem, shared: Array, own: Array) -> Array:
    def one(trial: Trial, observed: PaddedObservations, shared: Array, own: Array) -> Array:
        return problem.predict_one(trial, observed, shared, own, observed.all_rows)

    return map_over_runs(problem.batch, problem.mesh, one, shared, own)


@eqx.filter_jit
def _residual(problem: Problem, prediction: Array) -> Array:
    def one(_: Trial, observed: PaddedObservations, __: Array, simulated: Array) -> Array:
        # Beyond the samples compared a simulation may diverge.
        simulated = jnp.where(observed.weight > 0, simulated, observed.values)
        return problem.weighted(simulated, observed)

    return map_over_runs(problem.batch, problem.mesh, one, jnp.zeros(()), prediction)


@eqx.filter_jit
def _blocks(problem: Problem, shared: Array, own: Array) -> tuple[Array, Array]:
    number = len(problem.shared)

    def one(trial: Trial, observed: PaddedObservations, shared: Array, own: Array):
        def joint(both: Array) -> tuple[Array, Array]:
            residual = problem.residual_one(trial, observed, both[:number], both[number:])
            return residual, residual

        derivative, residual = jax.jacfwd(joint, has_aux=True)(jnp.concatenate([shared, own]))
        return residual, derivative

    return map_over_runs(problem.batch, problem.mesh, one, shared, own)


Coordinates = tuple[Float[Array, " shared"], Float[Array, "runs own"]]


def sample_gaps(observed: PaddedObservations) -> Float[Array, "channels samples"]:
    """Return the usual intervals between each compared sample and the compared one before [-].

    Infinite where the sample or the one before is not compared.
    """
    counts = observed.weight > 0
    follows = jnp.pad(counts[:, :-1], ((0, 0), (1, 0))) & counts
    return jnp.where(follows, observed.intervals, jnp.inf)


def coordinates_of(run: int, number: int, shared: int) -> Int[np.ndarray, " number"]:
    """Return the places of one run's coordinates among those of all runs.

    Args:
        run: Number of the run.
        number: Coordinates that a run has, shared ones included; these come first.
        shared: Number of shared coordinates.
    """
    own = number - shared
    return np.r_[0:shared, shared + run * own : shared + (run + 1) * own]


def normal_equations(
    blocks: np.ndarray, shared: int, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return $J^T J$ and $J^T r$ of all coordinates: shared ones, then each run's own.

    Args:
        blocks: Derivatives of each run, shape (runs, channels, samples, shared + own).
        shared: Number of shared coordinates.
        residual: Residuals, shape (runs, channels, samples).

    Returns:
        Shapes (all, all) and (all,), with all = shared + runs * own.
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
    """Return every run's channels [m, N, N m], shape (runs, channels, samples)."""
    return np.asarray(problem.prediction(*coordinates))


def linearize(problem: Problem, coordinates: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Return every run's weighted residuals, and their derivative by (shared, own)."""
    residual, blocks = problem.blocks(*coordinates)
    return np.asarray(residual), np.asarray(blocks)
