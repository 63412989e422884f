"""Starting point of a fit: each run's own zeta, estimated from its mean sinkage."""

import numpy as np
from jax import numpy as jnp

from drftjax.recorded.matched_zeta import ZetaMatchSettings, match_mean_sinkage
from identify.solver.problem import Coordinates, Problem, predict

ROUGH_MATCH = ZetaMatchSettings(max_steps=3)
"""A start needs no more steps: the solver goes on from it."""


def zeta_from_mean_sinkage(
    problem: Problem, start: Coordinates, settings: ZetaMatchSettings = ROUGH_MATCH
) -> Coordinates:
    """Coordinates at which each run's own zeta roughly matches its mean recorded sinkage.

    Costs a few simulations and no derivative, and spares the solver the long first steps after
    which the sum of squares of a fast run may be rough.

    Args:
        problem: Runs and parameters.
        start: Coordinates to start from; returned as they are where no run has a zeta of its own,
            or no sinkage was recorded.
        settings: Numbers of the secant search.

    Returns:
        `start` with the own zeta replaced in each run whose mean sinkage is matched better by it.
    """
    names = [each.quantity.name for each in problem.own]
    if "terrain.zeta" not in names or "z" not in problem.batch.channels:
        return start
    column, z = names.index("terrain.zeta"), problem.batch.channels.index("z")
    bijector = problem.own[column].bijector
    shared, own = start
    zeta = np.asarray(bijector.value(own[:, column]))
    recorded = np.asarray(problem.batch.observed.values)[:, z]
    counts = np.asarray(problem.batch.observed.weight)[:, z] > 0
    number = np.maximum(counts.sum(axis=1), 1)

    def coordinate(log_zeta: np.ndarray):
        at = bijector.coordinate(jnp.asarray(zeta * np.exp(log_zeta)))
        # A bound of zeta may lie between: such a run stays at its start.
        return jnp.where(jnp.isfinite(at), at, own[:, column])

    def miss(log_zeta: np.ndarray) -> np.ndarray:
        values = shared, own.at[:, column].set(coordinate(log_zeta))
        found = predict(problem, problem.on_all_devices(values))[:, z]
        return np.where(counts, found - recorded, 0).sum(axis=1) / number

    nought = np.zeros(len(zeta))
    first = miss(nought)
    found = match_mean_sinkage(miss, nought, miss_at_start=first, settings=settings)
    better = np.abs(found.miss) < np.abs(first)
    at = coordinate(np.where(better, found.log_zeta, nought))
    return problem.on_all_devices((shared, own.at[:, column].set(at)))
