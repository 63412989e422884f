"""Simulation of a run under a spline of log zeta, and its derivative by the knots."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from drftjax.physics.terrain import KnotZeta
from drftjax.recorded.batch import Batch, PaddedObservations, between_rows, map_over_runs
from drftjax.simulation.step_error import step_error
from drftjax.simulation.trial import Trial

# Standard deviation of the start's sinkage and travel about their recorded means, the unit of their
# coordinates [m].
START_SPREAD = 1e-3


# Coordinates of the start: x and z.
START_COORDINATES = 2


def with_zeta_knots(trial: Trial, ends: np.ndarray) -> Trial:
    """Return the trial with straight segments of zeta between these ends [s], all at one."""
    return eqx.tree_at(lambda t: t.simulator.terrain.zeta, trial, KnotZeta(ends, 1 + 0 * ends))


def path_trial(
    trial: Trial, curve: Float[Array, "ends knots"], coordinates: Float[Array, " all"]
) -> Trial:
    """Return the trial at these coordinates.

    Args:
        trial: A trial whose zeta is straight segments, from `with_zeta_knots`.
        curve: Values at the segments' ends per value at each knot, from `cardinal_splines`.
        coordinates: Log zeta at the knots, then the move of the start in x and z [START_SPREAD].
    """
    knots = curve.shape[1]
    trial = eqx.tree_at(
        lambda t: t.simulator.terrain.zeta.value, trial, jnp.exp(curve @ coordinates[:knots])
    )
    moved = trial.start.position + START_SPREAD * coordinates[knots:]
    return eqx.tree_at(lambda t: t.start.position, trial, moved)


def predict_path(
    trial: Trial,
    observed: PaddedObservations,
    channels: tuple[str, ...],
    curve: Float[Array, "ends knots"],
    coordinates: Float[Array, " all"],
) -> Float[Array, "channels samples"]:
    """Return the channels of one run at its recorded times [m], up to the last one compared."""
    drawn = path_trial(trial, curve, coordinates)
    return between_rows(drawn.run_to(observed.compared_rows, channels), observed)


@eqx.filter_jit
def _predictions(
    batch: Batch,
    mesh: Mesh,
    curves: Float[Array, "runs ends knots"],
    coordinates: Float[Array, "runs all"],
) -> Float[Array, "runs channels samples"]:
    def one(trial: Trial, observed: PaddedObservations, _, own: tuple[Array, Array]) -> Array:
        return predict_path(trial, observed, batch.channels, *own)

    return map_over_runs(batch, mesh, one, (), (curves, coordinates))


def step_errors(
    batch: Batch,
    mesh: Mesh,
    curves: Float[Array, "runs ends knots"],
    coordinates: Float[Array, "runs all"],
    runs: Sequence[int],
) -> Float[np.ndarray, "runs channels samples"]:
    """Return the error by the step of some runs' channels, to the last sample; zero for others.

    Args:
        batch, mesh, curves, coordinates: As for `predict_with_jacobian`.
        runs: Numbers of the runs in the batch.
    """
    observed = batch.observed
    rows = jnp.where(np.isin(np.arange(len(batch.order)), runs), observed.all_rows, 0)
    whole = eqx.tree_at(
        lambda b: (b.observed.compared_rows, b.observed.step_error),
        batch,
        (rows, jnp.zeros_like(observed.step_error)),
    )

    def simulated(parts: np.ndarray) -> np.ndarray:
        finer = eqx.tree_at(lambda b: b.trials.parts, whole, jnp.asarray(parts, int))
        return np.asarray(_predictions(finer, mesh, curves, coordinates))

    return step_error(simulated, batch.trials)


@eqx.filter_jit
def predict_with_jacobian(
    batch: Batch,
    mesh: Mesh,
    curves: Float[Array, "runs ends knots"],
    coordinates: Float[Array, "runs all"],
) -> tuple[Float[Array, "runs channels samples"], Float[Array, "runs channels samples all"]]:
    """Return every run's channels at its recorded times [m], and their derivative.

    Args:
        batch: Runs.
        mesh: Devices over which the runs are divided.
        curves: Of each run, as for `path_trial`.
        coordinates: Of each run, as for `path_trial`.

    Returns:
        As `predict_path`, and the derivative by each run's coordinates; zero for a run of which no
        row is compared.
    """

    def one(trial: Trial, observed: PaddedObservations, _, own: tuple[Array, Array]):
        curve, at = own

        def both(at: Array) -> tuple[Array, Array]:
            values = predict_path(trial, observed, batch.channels, curve, at)
            return values, values

        derivative, values = jax.jacfwd(both, has_aux=True)(at)
        return values, derivative

    return map_over_runs(batch, mesh, one, (), (curves, coordinates))
