"""Standard errors of fitted coordinates, honest about residuals that follow one another."""

from collections.abc import Sequence

import numpy as np

from identify.solver.problem import coordinates_of, normal_equations
from identify.solver.whitening import FINEST_RUN, Whitening
from identify.uncertainty.random_effects import paule_mandel

# A direction is seen where its information is over so many times what rounding leaves of none.
LEAST_TOLD = 100.0


def covariance(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None = None
) -> np.ndarray:
    r"""Covariance of (shared, run 1's own, run 2's own, ...) coordinates.

    The residual of each run and channel is taken as first-order autoregressive: its variance is
    measured, and (1 + rho) / (1 - rho) samples count as one. Beyond that the simulation itself may
    be off by a constant in every phase of the command, which no number of samples averages away.
    With such noise of covariance $S$, least squares that weighs every sample alike scatters by
    $A^{-1} J^T S J A^{-1}$, $A = J^T J$, which is more than the best that the samples would allow.
    A direction that the data do not see gets a very large variance.

    Args:
        blocks: Derivative of the weighted residuals by (shared, own) coordinates, shape (runs,
            channels, samples, shared + own).
        whitening: Of those residuals.
        shared: Number of shared coordinates.
        scatter: Variance of each shared coordinate from run to run, a random effect; none where
            left out.

    Returns:
        Covariance, shape (shared + runs * own,) squared.
    """
    noise = _noise(blocks, whitening, shared, scatter)
    values, vectors, size, unseen = _directions(_information(blocks, shared))
    root = vectors / np.sqrt(np.maximum(values, _floor(values))) / size[:, None]
    stretch = root.T @ noise @ root
    # Where rounding leaves nothing to tell, there is as little noise as information.
    stretch[unseen], stretch[:, unseen], stretch[unseen, unseen] = 0, 0, 1
    # The finest noise stretches no direction by less, but what rounding leaves of it may.
    more, along = np.linalg.eigh(stretch)
    spread = root @ along * np.sqrt(np.maximum(more, FINEST_RUN**2))
    return spread @ spread.T


def rescaled_covariance(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    r"""Information that is the inverse of `covariance` without priors, and what makes it.

    With $A = J^T J$, $K = A^{-1/2} J^T S J A^{-1/2}$: information $A^{1/2} K^{-1} A^{1/2}$, and the
    matrix $A^{1/2} K^{-1} A^{-1/2}$ that turns the slope $J^T r$ into that of a sum of squares with
    this curvature. Directions that the data do not see have none.
    """
    noise = _noise(blocks, whitening, shared, scatter)
    values, vectors, size, unseen = _directions(_information(blocks, shared))
    vectors, values = vectors[:, ~unseen], values[~unseen]
    inner = vectors / np.sqrt(values) / size[:, None]
    outer = vectors * np.sqrt(values) * size[:, None]
    more, along = np.linalg.eigh(inner.T @ noise @ inner)
    shrink = outer @ along / np.maximum(more, FINEST_RUN**2)
    return shrink @ (outer @ along).T, shrink @ (inner @ along).T


def null_directions(blocks: np.ndarray, shared: int, prior_slope: np.ndarray) -> np.ndarray:
    """Directions that neither data nor priors see, in columns.

    A coordinate's unit is what these would tell it to, were all others known.

    Args:
        blocks, shared: As for `covariance`.
        prior_slope: Derivative of each coordinate's prior residual; zero where it has none.
    """
    information = _information(blocks, shared) + np.diag(prior_slope**2)
    _, vectors, _, unseen = _directions(information)
    return vectors[:, unseen]


def per_run_steps(
    blocks: np.ndarray, residual: np.ndarray, kept: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Each run with values of its own, one straight-line step away.

    Args:
        blocks: As for `covariance`.
        residual: Weighted, shape (runs, channels, samples).
        kept: Which coordinates each run moves.

    Returns:
        The moves, shape (runs, kept), and the residuals after them, like `residual`.
    """
    moves = np.zeros((len(blocks), len(kept)))
    for run, block in enumerate(blocks[..., kept]):
        rows = block.reshape(-1, len(kept))
        moves[run] = -np.linalg.lstsq(rows, residual[run].ravel(), rcond=None)[0]
    return moves, residual + np.einsum("rcsp,rp->rcs", blocks[..., kept], moves)


def between_run_variance(
    moves: np.ndarray, blocks: np.ndarray, whitening: "Whitening", scattered: int
) -> np.ndarray:
    """Variance from run to run of coordinates, beyond what each run can tell of them.

    Args:
        moves: Of each run alone, shape (runs, coordinates).
        blocks: Derivatives of the weighted residuals by these, shape (runs, channels, samples,
            coordinates).
        whitening: Of what is left after the moves.
        scattered: How many coordinates, the first ones, are asked about.
    """
    told = np.flatnonzero(blocks.any(axis=(1, 2, 3))).tolist()
    spread = [
        np.diag(covariance(blocks[run][None], whitening.of_run(run), blocks.shape[-1]))
        for run in told
    ]
    errors = np.sqrt(np.reshape(spread, (len(told), blocks.shape[-1])))
    return np.array([paule_mandel(moves[told, k], errors[:, k]).variance for k in range(scattered)])


def _noise(
    blocks: np.ndarray, whitening: "Whitening", shared: int, scatter: np.ndarray | None
) -> np.ndarray:
    """J^T S J of the noise, with what shared coordinates scatter by from run to run."""
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
    """Eigenvalues and vectors of the information over each coordinate's own; the root of that
    own; and which directions rounding alone may have made."""
    alone = np.diag(information)
    most = alone.max(initial=0)
    size = np.sqrt(np.where(alone > 0, alone, most if most > 0 else 1.0))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    return values, vectors, size, values <= LEAST_TOLD * _floor(values)


def _floor(values: np.ndarray) -> float:
    """The least information that rounding leaves to tell from none."""
    return float(values.max(initial=1.0) * np.finfo(float).eps * max(len(values), 1))


def regularized_inverse(information: np.ndarray) -> np.ndarray:
    """Its inverse; a direction without information gets a very large variance."""
    values, vectors, size, _ = _directions(information)
    root = vectors / np.sqrt(np.maximum(values, _floor(values))) / size[:, None]
    return root @ root.T
