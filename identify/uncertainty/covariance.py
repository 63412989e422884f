"""Covariance of fitted coordinates where residuals are correlated: sandwich estimator."""

from collections.abc import Sequence

import numpy as np

from drftjax.results.random_effects import paule_mandel
from identify.solver.problem import coordinates_of, normal_equations
from identify.solver.whitening import Whitening

# A direction is determined where its information exceeds this many times the rounding errors.
ROUNDING_MARGIN = 100.0


def covariance(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None = None
) -> np.ndarray:
    r"""Return the covariance of (shared, run 1's own, run 2's own, ...) coordinates.

    The variance of each run's and channel's residual is measured, and so many samples count as one
    as the noise model says; beyond that the simulation itself may be off by a constant in every
    phase of the command, which no number of samples averages away. With such noise of covariance
    $S$, least squares with equal weights has the covariance

    $$A^{-1} J^T S J A^{-1}, \qquad A = J^T J$$

    (H. White, Econometrica 48:817, 1980), larger than the best that the samples would allow. A
    direction that the data do not determine gets a very large variance.

    Args:
        blocks: Derivative J of the weighted residuals by (shared, own) coordinates, shape (runs,
            channels, samples, shared + own).
        whitening: Of those residuals.
        shared: Number of shared coordinates.
        scatter: Variance of each shared coordinate from run to run, a random effect, shape
            (shared,); none where left out.

    Returns:
        Covariance, shape (all, all) with all = shared + runs * own.
    """
    noise = _noise(blocks, whitening, shared, scatter)
    values, vectors, size, unseen = _directions(_information(blocks, shared))
    root = vectors / np.sqrt(np.maximum(values, _rounding(values))) / size[:, None]
    stretch = root.T @ noise @ root
    # Where rounding leaves no information, it leaves no noise either.
    stretch[unseen], stretch[:, unseen], stretch[unseen, unseen] = 0, 0, 1
    # The finest noise stretches no direction by less, but what rounding leaves of it may.
    more, along = np.linalg.eigh(stretch)
    spread = root @ along * np.sqrt(np.maximum(more, whitening.finest**2))
    return spread @ spread.T


def rescaled_covariance(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    r"""Return the inverse of `covariance`, and the matrix that rescales slopes accordingly.

    With $A = J^T J$ and $K = A^{-1/2} J^T S J A^{-1/2}$ these are the information
    $A^{1/2} K^{-1} A^{1/2}$, and $A^{1/2} K^{-1} A^{-1/2}$, which turns the slope $J^T r$ into that
    of a sum of squares with this curvature. Both are zero along directions that the data do not
    determine. Arguments as for `covariance`; both shapes are (all, all).
    """
    noise = _noise(blocks, whitening, shared, scatter)
    values, vectors, size, unseen = _directions(_information(blocks, shared))
    vectors, values = vectors[:, ~unseen], values[~unseen]
    inner = vectors / np.sqrt(values) / size[:, None]
    outer = vectors * np.sqrt(values) * size[:, None]
    more, along = np.linalg.eigh(inner.T @ noise @ inner)
    shrink = outer @ along / np.maximum(more, whitening.finest**2)
    return shrink @ (outer @ along).T, shrink @ (inner @ along).T


def null_directions(blocks: np.ndarray, shared: int, prior_slope: np.ndarray) -> np.ndarray:
    """Return the directions that neither data nor priors determine.

    Args:
        blocks, shared: As for `covariance`.
        prior_slope: Derivative of each coordinate's prior residual, shape (all,); zero without a
            prior.

    Returns:
        Unit vectors in columns, shape (all, directions). A coordinate's unit is the standard error
        that it would have, were all others known.
    """
    information = _information(blocks, shared) + np.diag(prior_slope**2)
    _, vectors, _, unseen = _directions(information)
    return vectors[:, unseen]


def per_run_steps(
    blocks: np.ndarray, residual: np.ndarray, kept: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return one Gauss-Newton step of each run with values of its own.

    Args:
        blocks: As for `covariance`.
        residual: Weighted, shape (runs, channels, samples).
        kept: Coordinates that each run moves.

    Returns:
        The steps, shape (runs, kept), and the residuals after them, like `residual`.
    """
    moves = np.zeros((len(blocks), len(kept)))
    for run, block in enumerate(blocks[..., kept]):
        rows = block.reshape(-1, len(kept))
        moves[run] = -np.linalg.lstsq(rows, residual[run].ravel(), rcond=None)[0]
    return moves, residual + np.einsum("rcsp,rp->rcs", blocks[..., kept], moves)


def between_run_variance(
    moves: np.ndarray, blocks: np.ndarray, whitening: "Whitening", scattered: int
) -> np.ndarray:
    """Return the variance of coordinates from run to run, beyond each run's own errors.

    Args:
        moves: Step of each run alone, shape (runs, coordinates).
        blocks: Derivatives of the weighted residuals by these, shape (runs, channels, samples,
            coordinates).
        whitening: Of the residuals after these steps.
        scattered: Number of coordinates, the first ones, whose variance is returned.

    Returns:
        Shape (scattered,); by Paule and Mandel.
    """
    known = np.flatnonzero(blocks.any(axis=(1, 2, 3))).tolist()
    spread = [
        np.diag(covariance(blocks[run][None], whitening.of_run(run), blocks.shape[-1]))
        for run in known
    ]
    errors = np.sqrt(np.reshape(spread, (len(known), blocks.shape[-1])))
    return np.array(
        [paule_mandel(moves[known, k], errors[:, k]).variance for k in range(scattered)]
    )


def _noise(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None
) -> np.ndarray:
    """Return J^T S J of the noise, the scatter of shared coordinates from run to run included."""
    noise = _information(whitening.colour(blocks), shared)
    if scatter is None:
        return noise
    for coordinate in np.flatnonzero(scatter):
        for run, block in enumerate(blocks):
            place = coordinates_of(run, blocks.shape[-1], shared)
            rows = block.reshape(-1, blocks.shape[-1])
            along = rows.T @ rows[:, coordinate]
            noise[np.ix_(place, place)] += scatter[coordinate] * np.outer(along, along)
    return noise


def _information(blocks: np.ndarray, shared: int) -> np.ndarray:
    return normal_equations(blocks, shared, np.zeros(blocks.shape[:3]))[0]


def _directions(
    information: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigensystem of the information scaled to a unit diagonal.

    Returns:
        Eigenvalues; eigenvectors in columns; scale of each coordinate; True for directions that
        rounding alone may have made.
    """
    alone = np.diag(information)
    most = alone.max(initial=0)
    size = np.sqrt(np.where(alone > 0, alone, most if most > 0 else 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    return values, vectors, size, values <= ROUNDING_MARGIN * _rounding(values)


def _rounding(values: np.ndarray) -> float:
    """Return the smallest information that rounding lets one tell from none."""
    return float(values.max(initial=1.0) * np.finfo(float).eps * max(len(values), 1))


def regularized_inverse(information: np.ndarray) -> np.ndarray:
    """Return the inverse; a direction without information gets a very large variance."""
    values, vectors, size, _ = _directions(information)
    root = vectors / np.sqrt(np.maximum(values, _rounding(values))) / size[:, None]
    return root @ root.T
