"""Where a fit starts: each run's own zeta as its mean sinkage tells it, before any derivative."""

import numpy as np
from jax import numpy as jnp

from identify.solver.problem import Coordinates, Problem, predict

# Secant steps; the solver goes on from what they leave.
TURNS = 3


# The first step, and the longest, as shares of zeta.
FIRST, LONGEST = 0.03, 0.25


def zeta_from_mean_sinkage(problem: Problem, start: Coordinates) -> Coordinates:
    """Coordinates at which each run's own zeta about meets its mean recorded sinkage.

    Costs a few simulations and no derivative, and spares the solver the long first steps on which
    a fast run may land where its sum of squares is rough.

    Args:
        problem: Runs and parameters.
        start: Coordinates to start from; returned as they are where no run has a zeta of its own,
            or no sinkage was recorded.
    """
    names = [each.quantity.name for each in problem.own]
    if "terrain.zeta" not in names or "z" not in problem.batch.channels:
        return start
    column, z = names.index("terrain.zeta"), problem.batch.channels.index("z")
    bijector = problem.own[column].bijector
    shared, own = start
    recorded = np.asarray(problem.batch.observed.values)[:, z]
    counts = np.asarray(problem.batch.observed.weight)[:, z] > 0
    number = np.maximum(counts.sum(axis=1), 1)

    def miss(zeta: np.ndarray) -> np.ndarray:
        at = own.at[:, column].set(bijector.coordinate(jnp.asarray(zeta)))
        found = predict(problem, problem.on_all_devices((shared, at)))[:, z]
        return np.where(counts, found - recorded, 0).sum(axis=1) / number

    first = np.asarray(bijector.value(own[:, column]))
    before, here = first, first * (1 + FIRST)
    missed = miss(before)
    best, least = before, np.abs(missed)
    for _ in range(TURNS):
        now = miss(here)
        better = np.abs(now) < least
        best, least = np.where(better, here, best), np.where(better, np.abs(now), least)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -now * (here - before) / (now - missed)
        step = np.clip(np.nan_to_num(step), -LONGEST * here, LONGEST * here)
        before, missed, here = here, now, here + step
    at = bijector.coordinate(jnp.asarray(best))
    # A bound may lie between.
    at = jnp.where(jnp.isfinite(at), at, own[:, column])
    return problem.on_all_devices((shared, own.at[:, column].set(at)))
