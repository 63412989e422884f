"""Priors and runs, each for what it tells.

Least squares that weigh every sample alike find as good values as others where only runs speak, and
their errors say how much less than so many samples they tell. A prior is another matter: held
against samples that follow one another, or against a simulation that may itself be off, it would
be outweighed by what they do not know. So where there is a prior the residuals are whitened, by how
those of the plain fit scatter, and the fit goes on from there.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from identify.descent import Descent
from identify.optimum import Optimum, linearised
from identify.solve import Solution
from identify.uncertainty import Whitening, covariance


def weighed(optimum: Optimum, progress: Callable[[int, int], None] | None = None) -> Optimum:
    """The optimum of whitened residuals and priors.

    Args:
        optimum: Of the same runs and parameters, each sample weighed alike.
        progress: Called with the number of the step and of fits that still move.
    """
    whitening, active = optimum.whitening, optimum.solution.active
    descent = Descent(optimum.problem, len(optimum.candidates), whitening, active)
    ends = descent.run(optimum.flat[None], progress=progress)
    solution = replace(
        _at(optimum, ends.points[0]), status="converged" if ends.settled[0] else "stalled"
    )
    counts = whitening.scale > 0
    even = Whitening(counts.astype(float), np.zeros(counts.shape), whitening.phase)
    spread = covariance(solution.blocks, even, optimum.shared, solution.belief_slope)
    return replace(optimum, solution=solution, covariance=spread, whitened=True)


def _at(optimum: Optimum, flat: np.ndarray) -> Solution:
    """The solution moved to other coordinates, its residuals whitened."""
    problem, coordinates = optimum.problem, optimum.coordinates(flat)
    residual, blocks = linearised(problem, coordinates)
    counts = optimum.whitening.scale > 0
    ones = jax.tree.map(jnp.ones_like, coordinates)
    beliefs, slopes = jax.jvp(lambda *at: problem.beliefs(*at), coordinates, ones)
    belief, slope = (np.concatenate([np.ravel(p) for p in part]) for part in (beliefs, slopes))
    return replace(
        optimum.solution,
        coordinates=coordinates,
        residual=optimum.whitening.apply(np.where(counts, residual, 0)),
        blocks=optimum.whitening.apply(np.where(counts[..., None], blocks, 0)),
        belief=belief,
        belief_slope=slope,
    )
