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
from identify.uncertainty.covariance import regularized_inverse, rescaled_covariance
from identify.uncertainty.estimate import Estimate

MOST_STEPS = 40


# Longest step in the unbounded coordinates, and the step, in standard errors, that ends the fit.
LONGEST_STEP, SMALL_STEP = 0.3, 0.03


def apply_priors(
    estimate: Estimate, progress: Callable[[int, float], None] | None = None
) -> Estimate:
    """The most probable values by runs and priors.

    Args:
        estimate: Of the same runs and parameters, each sample weighed alike.
        progress: Called with the number of the step and its size in standard errors.
    """
    flat, status, shared = estimate.flat, "stalled", estimate.shared
    here = _at(estimate, flat)
    share, total = _rescaled(estimate, here)
    for number in range(1, MOST_STEPS + 1):
        data = normal_equations(here.blocks, shared, here.residual)[1]
        slope = share @ data + here.prior_slope * here.prior_residual
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
        ahead = _at(estimate, flat + move)
        if not (np.isfinite(ahead.residual).all() and np.isfinite(ahead.blocks).all()):
            break
        flat, here = flat + move, ahead
        share, total = _rescaled(estimate, here)
    solution = replace(here, status=status)
    return replace(
        estimate, solution=solution, covariance=regularized_inverse(total), slope_rescaling=share
    )


def _rescaled(estimate: Estimate, at: Solution) -> tuple[np.ndarray, np.ndarray]:
    """What rescales the runs' slope, and the information of runs and priors together."""
    information, share = rescaled_covariance(
        at.blocks, estimate.whitening, estimate.shared, estimate.run_variance
    )
    return share, information + np.diag(at.prior_slope**2)


def _at(estimate: Estimate, flat: np.ndarray) -> Solution:
    """The solution moved to other coordinates."""
    problem, coordinates = estimate.problem, estimate.coordinates(flat)
    residual, blocks = linearize(problem, coordinates)
    counts = estimate.whitening.scale > 0
    ones = jax.tree.map(jnp.ones_like, coordinates)
    priors, slopes = jax.jvp(problem.prior_residuals, coordinates, ones)
    prior, slope = (np.concatenate([np.ravel(p) for p in part]) for part in (priors, slopes))
    return replace(
        estimate.solution,
        coordinates=coordinates,
        residual=np.where(counts, residual, 0),
        blocks=np.where(counts[..., None], blocks, 0),
        prior_residual=prior,
        prior_slope=slope,
    )


# A prior and the runs contradict each other where they lie so many of their errors apart; chance
# makes that once in 370 times.
CONTRADICT = 3.0


# Of a number of which the runs tell less than this share of what is known, they say nothing.
LEAST_SHARE = 1e-3


def prior_conflicts(estimate: Estimate) -> list[str]:
    """Sentences on priors that lie far from what the runs alone would tell.

    With a prior of error p the value has the error v, and the runs alone e: 1/v² = 1/p² + 1/e².
    The value lies b errors p from the prior, so the runs alone b / sqrt(1 - v²/p²) errors
    sqrt(p² + e²).

    Args:
        estimate: Where the fit ended; in its unbounded coordinates all errors are straight.
    """
    size = len(estimate.coordinate_parameters)
    variance = np.diag(estimate.covariance)[:size]
    slope = estimate.solution.prior_slope[:size]
    prior = estimate.solution.prior_residual[:size]
    share = 1 - variance * slope**2
    known = (slope != 0) & (share > LEAST_SHARE)
    apart = np.abs(prior) / np.sqrt(np.where(known, share, 1.0))
    return [
        f"{label}: its prior and the runs contradict each other, by {far:.1f} of their errors; the "
        "value is a compromise that neither believes"
        for label, far, told in zip(estimate.labels, apart, known, strict=True)
        if told and far > CONTRADICT
    ]
