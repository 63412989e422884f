"""Priors and runs, each for what it tells.

Least squares that weigh every sample alike find as good values as others where only runs speak, and
their errors say how much less than so many samples they tell. A prior, though, would be outweighed
by samples that follow one another, and by a simulation that may itself be off. So where there is a
prior, the sum of squares is rescaled along each direction until its curvature is the inverse of
that fit's covariance, which leaves its least place where it is (R. E. Chandler, S. Bate: Inference
for clustered data using the independence loglikelihood, Biometrika 94:167, 2007), and the prior is
held against that.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from identify.solver.levenberg_marquardt import Solution
from identify.solver.problem import linearize, normal_equations
from identify.uncertainty.covariance import inverse, rescaled_covariance
from identify.uncertainty.estimate import Estimate

MOST_STEPS = 40


# Longest step in the unbounded coordinates, and the step, in standard errors, that ends the fit.
LONGEST_STEP, SMALL_STEP = 0.3, 0.03


def apply_priors(
    optimum: Estimate, progress: Callable[[int, float], None] | None = None
) -> Estimate:
    """The most probable values by runs and priors.

    Args:
        optimum: Of the same runs and parameters, each sample weighed alike.
        progress: Called with the number of the step and its size in standard errors.
    """
    flat, status, shared = optimum.flat, "stalled", optimum.shared
    here = _at(optimum, flat)
    share, total = _rescaled(optimum, here)
    for number in range(1, MOST_STEPS + 1):
        data = normal_equations(here.blocks, shared, here.residual)[1]
        slope = share @ data + here.belief_slope * here.belief
        unit = np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
        in_units = np.linalg.lstsq(total / np.outer(unit, unit), slope / unit, rcond=None)[0]
        move = -in_units / unit
        size = float(np.sqrt(max(move @ total @ move, 0.0)))
        if progress:
            progress(number, size)
        if size < SMALL_STEP:
            status = "converged"
            break
        move = move[: len(flat)] * min(1.0, LONGEST_STEP / np.abs(move).max())
        ahead = _at(optimum, flat + move)
        if not (np.isfinite(ahead.residual).all() and np.isfinite(ahead.blocks).all()):
            break
        flat, here = flat + move, ahead
        share, total = _rescaled(optimum, here)
    solution = replace(here, status=status)
    return replace(optimum, solution=solution, covariance=inverse(total), share=share)


def _rescaled(optimum: Estimate, at: Solution) -> tuple[np.ndarray, np.ndarray]:
    """What rescales the runs' slope, and the information of runs and priors together."""
    information, share = rescaled_covariance(
        at.blocks, optimum.whitening, optimum.shared, optimum.scatter
    )
    return share, information + np.diag(at.belief_slope**2)


def _at(optimum: Estimate, flat: np.ndarray) -> Solution:
    """The solution moved to other coordinates."""
    problem, coordinates = optimum.problem, optimum.coordinates(flat)
    residual, blocks = linearize(problem, coordinates)
    counts = optimum.whitening.scale > 0
    ones = jax.tree.map(jnp.ones_like, coordinates)
    beliefs, slopes = jax.jvp(problem.prior_residuals, coordinates, ones)
    belief, slope = (np.concatenate([np.ravel(p) for p in part]) for part in (beliefs, slopes))
    return replace(
        optimum.solution,
        coordinates=coordinates,
        residual=np.where(counts, residual, 0),
        blocks=np.where(counts[..., None], blocks, 0),
        belief=belief,
        belief_slope=slope,
    )


# A prior and the runs contradict each other where they lie so many of their errors apart; chance
# makes that once in 370 times.
CONTRADICT = 3.0


# Of a number of which the runs tell less than this share of what is known, they say nothing.
LEAST_SHARE = 1e-3


def prior_conflicts(optimum: Estimate) -> list[str]:
    """Sentences on priors that lie far from what the runs alone would tell.

    With a prior of error p the value has the error v, and the runs alone e: 1/v² = 1/p² + 1/e².
    The value lies b errors p from the prior, so the runs alone b / sqrt(1 - v²/p²) errors
    sqrt(p² + e²).

    Args:
        optimum: Where the fit ended; in its unbounded coordinates all errors are straight.
    """
    size = len(optimum.ordered)
    variance = np.diag(optimum.covariance)[:size]
    slope = optimum.solution.belief_slope[:size]
    belief = optimum.solution.belief[:size]
    share = 1 - variance * slope**2
    known = (slope != 0) & (share > LEAST_SHARE)
    apart = np.abs(belief) / np.sqrt(np.where(known, share, 1.0))
    return [
        f"{label}: its prior and the runs contradict each other, by {far:.1f} of their errors; the "
        "value is a compromise that neither believes"
        for label, far, told in zip(optimum.labels, apart, known, strict=True)
        if told and far > CONTRADICT
    ]
