r"""Posterior density of a fit's coordinates, with the exact slope of the simulation.

Two likelihoods of the runs, by the settings:

- White: $\ell = -\tfrac12 |r|^2$ of the weighted, whitened residuals r that the last solve
  minimises. Their samples are independent then, and the simulation makes no error of its own.
- Magnitude-adjusted (R. E. Chandler, S. Bate: Inference for clustered data using the independence
  loglikelihood, Biometrika 94:167, 2007, the vertical adjustment): the rise of that sum of squares
  above its tangent at the fitted point, rescaled along each direction d by $d^T G d / d^T A d$.
  $A = J^T J$ is its curvature and $G$ the inverse of the sandwich covariance, so that the density's
  curvature at the fitted point is that of the standard errors. Its slope there is the rescaled one
  that `identify.uncertainty.priors` makes zero.

A prior is Gaussian in the parameter's value; without one all values within the bounds are equally
likely. The density is one of values; the solver's coordinates u take the term $\log dv/du$.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from drftjax.common.errors import InputError
from identify.parameters.bijector import Interval
from identify.solver.problem import Coordinates, Problem, normal_equations
from identify.uncertainty.covariance import (
    null_directions,
    regularized_inverse,
    rescaled_covariance,
)
from identify.uncertainty.estimate import Estimate

# Variance of the logistic distribution, which the coordinate of a uniform bounded value has.
LOGISTIC_VARIANCE = math.pi**2 / 3


# Share of all information that each form of it is given more: where the runs tell nothing, the
# ratio of two roundings is one then.
ROUNDING_SHARE = 1e-9


# Share of a coordinate's unit length in undetermined directions that is more than rounding.
LOST = 1e-6


class Adjustment(eqx.Module):
    """Rescaling of the runs' sum of squares about the fitted point.

    Attributes:
        least: Half the sum of squares there.
        slope: Its slope there, shape (coordinates,).
        rescaled_slope: The slope that takes its place, likewise.
        curvature, rescaled_curvature: Likewise of its curvature, shape (coordinates, coordinates).
    """

    least: Float[Array, ""]
    slope: Float[Array, " coordinates"]
    rescaled_slope: Float[Array, " coordinates"]
    curvature: Float[Array, "coordinates coordinates"]
    rescaled_curvature: Float[Array, "coordinates coordinates"]

    def __call__(
        self, half_squares: Float[Array, ""], move: Float[Array, " coordinates"]
    ) -> Float[Array, ""]:
        """Return the adjusted half sum of squares, less a constant, after a move of coordinates."""
        rise = half_squares - self.least - self.slope @ move
        plain, wanted = move @ self.curvature @ move, move @ self.rescaled_curvature @ move
        moved = plain > 0
        scale = jnp.where(moved, wanted / jnp.where(moved, plain, 1.0), 1.0)
        return scale * rise + self.rescaled_slope @ move


class PosteriorDensity(eqx.Module):
    """Logarithm of the posterior density of free coordinates, less a constant.

    Attributes:
        problem: Runs and parameters, with the weights of the last solve.
        counts: True for samples that count, shape (padded runs, channels, samples).
        centre: Fitted point: shared coordinates, then each true run's own, shape (coordinates,).
        free: Places in it of the coordinates that move; those of runs put aside do not.
        adjustment: Of the likelihood; none where residuals are white.
        covariance: Approximate covariance of the free coordinates, shape (free, free).
    """

    problem: Problem
    counts: Bool[Array, "runs channels samples"]
    centre: Float[Array, " coordinates"]
    free: Int[Array, " free"]
    adjustment: Adjustment | None
    covariance: Float[Array, "free free"]

    @classmethod
    def of(cls, estimate: Estimate, adjusted: bool) -> "PosteriorDensity":
        """Return the density of a fit.

        Args:
            estimate: Of the fit.
            adjusted: Adjust the likelihood to the standard errors' covariance.

        Raises:
            InputError: where a value has neither bounds nor a prior and the runs do not determine
                it: no density is proper then.
        """
        solution, shared, size = estimate.solution, estimate.shared, len(estimate.flat)
        active = solution.active
        free = np.array(
            [k for k, (_, r) in enumerate(estimate.coordinate_parameters) if r is None or active[r]]
        )
        parameters = [parameter for parameter, _ in estimate.coordinate_parameters]
        bounded = np.array([isinstance(each.bijector, Interval) for each in parameters])
        beliefs = solution.prior_slope[:size] ** 2 + bounded / LOGISTIC_VARIANCE
        blocks, residual = solution.blocks, solution.residual
        _require_proper(estimate, beliefs, free)
        curvature, slope = normal_equations(blocks, shared, residual)
        rescaled, share = curvature, np.eye(len(curvature))
        if adjusted:
            whitening, scatter = estimate.whitening, estimate.run_variance
            rescaled, share = rescaled_covariance(blocks, whitening, shared, scatter)
        here = np.s_[:size, :size]
        total = rescaled[here] + np.diag(beliefs)
        least = ROUNDING_SHARE * total
        adjustment = Adjustment(
            jnp.asarray(0.5 * np.sum(residual**2)),
            jnp.asarray(slope[:size]),
            jnp.asarray((share @ slope)[:size]),
            jnp.asarray(curvature[here] + least),
            jnp.asarray(rescaled[here] + least),
        )
        return cls(
            estimate.problem,
            jnp.asarray(np.asarray(estimate.problem.batch.observed.weight) > 0)
            & jnp.asarray(active)[:, None, None],
            jnp.asarray(estimate.flat),
            jnp.asarray(free),
            adjustment if adjusted else None,
            jnp.asarray(regularized_inverse(total[np.ix_(free, free)])),
        )

    def __call__(self, coordinates: Float[Array, " free"]) -> Float[Array, ""]:
        """Return the logarithm of the density; minus infinity where nothing can be simulated."""
        point = self.centre.at[self.free].set(coordinates)
        squares = self._half_squares(point)
        if self.adjustment is not None:
            squares = self.adjustment(squares, point - self.centre)
        density = self._beliefs(point) - squares
        return jnp.where(jnp.isfinite(density), density, -jnp.inf)

    def _half_squares(self, point: Float[Array, " coordinates"]) -> Float[Array, ""]:
        """Return half the sum of squared residuals; its slope is that of forward sweeps."""
        fixed = jax.lax.stop_gradient(point)
        residual, blocks = self.problem.blocks(*self._split(fixed))
        residual = jnp.where(self.counts, residual, 0.0)
        blocks = jnp.where(self.counts[..., None], blocks, 0.0)
        each = jnp.einsum("rcsp,rcs->rp", blocks, residual)
        shared = len(self.problem.shared)
        true = self._own_of(point).shape[0]
        slope = jnp.concatenate([each[:, :shared].sum(axis=0), each[:true, shared:].ravel()])
        # A loop of a simulation's length has no reverse sweep: the tangent carries its slope.
        return 0.5 * jnp.sum(residual**2) + slope @ (point - fixed)

    def _beliefs(self, point: Float[Array, " coordinates"]) -> Float[Array, ""]:
        """Return the priors' part, with the term that makes it a density of coordinates."""
        shared, own = point[: len(self.problem.shared)], self._own_of(point)
        priors = self.problem.prior_residuals(*self._split(point))
        squares = 0.5 * (jnp.sum(priors[0] ** 2) + jnp.sum(priors[1] ** 2))
        slopes = [p.bijector.slope(shared[k]) for k, p in enumerate(self.problem.shared)]
        slopes += [p.bijector.slope(own[:, k]) for k, p in enumerate(self.problem.own)]
        return jnp.sum(jnp.log(jnp.hstack(slopes))) - squares

    def _own_of(self, point: Float[Array, " coordinates"]) -> Float[Array, "runs own"]:
        """Return the true runs' own coordinates."""
        shared, own = len(self.problem.shared), len(self.problem.own)
        return point[shared:].reshape(-1 if own else 0, own)

    def _split(self, point: Float[Array, " coordinates"]) -> Coordinates:
        """Return coordinates as the problem takes them; padded runs repeat the first."""
        own = self._own_of(point)
        rows = self.counts.shape[0]
        if not len(own):
            return point[: len(self.problem.shared)], jnp.zeros((rows, 0), point.dtype)
        padding = jnp.repeat(own[:1], rows - len(own), axis=0)
        return point[: len(self.problem.shared)], jnp.concatenate([own, padding])


def _require_proper(estimate: Estimate, beliefs: np.ndarray, free: np.ndarray) -> None:
    """Raise InputError where nothing holds a coordinate: neither runs nor bounds nor a prior."""
    blocks = estimate.solution.blocks[: len(estimate.runs)]
    lost = np.sum(null_directions(blocks, estimate.shared, np.sqrt(beliefs)) ** 2, axis=1)
    loose = [estimate.labels[k] for k in free if lost[k] > LOST]
    if loose:
        raise InputError(
            f"these runs do not determine {', '.join(loose)}: there is no posterior without bounds "
            "or a prior of it (--parameters)"
        )
