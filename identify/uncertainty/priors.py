r"""Posterior mode with priors, by the magnitude-adjusted likelihood of Chandler & Bate (2007).

Without priors, least squares with equal weights is unbiased whatever the correlation of the
samples, and the sandwich covariance states its errors. Added to that sum of squares, a prior would
be outweighed by correlated samples and by the simulation's own error. So the sum of squares is
rescaled along each direction until its curvature is the inverse of the sandwich covariance, which
leaves its minimum in place (R. E. Chandler, S. Bate: Inference for clustered data using the
independence loglikelihood, Biometrika 94:167, 2007), and the priors' squares are added to that.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from identify.solver.levenberg_marquardt import Solution
from identify.solver.problem import linearize, normal_equations
from identify.uncertainty.covariance import regularized_inverse, rescaled_covariance
from identify.uncertainty.estimate import Estimate


@dataclass(frozen=True)
class PriorSettings:
    """Numbers of the fit with priors and of the conflicts that it reports.

    Attributes:
        max_steps: Gauss-Newton steps, at most.
        longest_step: Longest step in the unbounded coordinates.
        small_step: Step that ends the fit, in standard errors.
        conflict: A prior and the runs are in conflict where they lie so many of their joint
            standard errors apart; chance makes that once in 370 times.
        least_share: A value that owes less than this share of its information to the runs is
            determined by its prior alone, and has no conflict.
    """

    max_steps: int = 40
    longest_step: float = 0.3
    small_step: float = 0.03
    conflict: float = 3.0
    least_share: float = 1e-3


PRIOR_SETTINGS = PriorSettings()


def apply_priors(
    estimate: Estimate,
    progress: Callable[[int, float], None] | None = None,
    settings: PriorSettings = PRIOR_SETTINGS,
) -> Estimate:
    """Return the estimate at the posterior mode of runs and priors.

    Args:
        estimate: Of the same runs and parameters, every sample weighted equally.
        progress: Called with the number of the step and its size in standard errors.
        settings: Decision numbers.
    """
    flat, status, shared = estimate.flat, "stalled", estimate.shared
    here = _at(estimate, flat)
    share, total = _rescaled(estimate, here)
    for number in range(1, settings.max_steps + 1):
        data = normal_equations(here.blocks, shared, here.residual)[1]
        slope = share @ data + here.prior_slope * here.prior_residual
        unit = np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
        in_units = np.linalg.lstsq(total / np.outer(unit, unit), slope / unit, rcond=None)[0]
        move = -in_units / unit
        size = float(np.sqrt(max(move @ total @ move, 0.0)))
        if progress:
            progress(number, size)
        if size < settings.small_step:
            status = "converged"
            break
        move = move[: len(flat)] * min(1.0, settings.longest_step / np.abs(move).max())
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
    """Return the matrix that rescales the runs' slope, and the information of runs and priors."""
    information, share = rescaled_covariance(
        at.blocks, estimate.whitening, estimate.shared, estimate.run_variance
    )
    return share, information + np.diag(at.prior_slope**2)


def _at(estimate: Estimate, flat: np.ndarray) -> Solution:
    """Return the solution moved to other coordinates."""
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


def prior_conflicts(estimate: Estimate, settings: PriorSettings = PRIOR_SETTINGS) -> list[str]:
    r"""Return sentences on priors that lie far from the values by the runs alone.

    With a prior of error p the value has the error v, and by the runs alone e:
    $1/v^2 = 1/p^2 + 1/e^2$. A value that lies b errors p from its prior would, by the runs alone,
    lie $b / \sqrt{1 - v^2/p^2}$ errors $\sqrt{p^2 + e^2}$ from it.

    Args:
        estimate: Its unbounded coordinates are taken as Gaussian.
        settings: Decision numbers.
    """
    size = len(estimate.coordinate_parameters)
    variance = np.diag(estimate.covariance)[:size]
    slope = estimate.solution.prior_slope[:size]
    prior = estimate.solution.prior_residual[:size]
    share = 1 - variance * slope**2
    known = (slope != 0) & (share > settings.least_share)
    distance = np.abs(prior) / np.sqrt(np.where(known, share, 1.0))
    return [
        f"{label}: its prior and the runs contradict each other, by {far:.1f} of their errors; the "
        "value is a compromise that neither believes"
        for label, far, determined in zip(estimate.labels, distance, known, strict=True)
        if determined and far > settings.conflict
    ]
