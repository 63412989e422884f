"""Standard errors of fitted coordinates, honest about residuals that follow one another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.solve import coordinates_of, normal_equations
from identify.spread import spread_of

# Beyond this the inflation is no longer an estimate but a statement that the samples are one.
LARGEST_CORRELATION = 0.9999
# Residuals of a run are taken for no finer than this share of what its channel is weighed by: what
# few samples leave, or a simulation fitted to itself, is no noise.
FINEST_RUN = 0.1
# A direction is seen where its information is over so many times what rounding leaves of none.
LEAST_TOLD = 100.0


def lag_one_correlation(residual: np.ndarray, counts: np.ndarray, intervals: np.ndarray) -> float:
    """Correlation of a residual with its neighbour [-], over the samples that count.

    Args:
        residual, counts: Of one channel of a run, shape (samples,).
        intervals: Usual intervals from the sample before; after a gap none is a neighbour.
    """
    both = counts[1:] & counts[:-1] & (intervals[1:] == 1)
    power = np.sum(residual[counts] ** 2)
    if power == 0 or not both.any():
        return 0.0
    scale = counts.sum() / both.sum()
    return float(
        np.clip(scale * np.sum(residual[1:] * residual[:-1] * both) / power, 0, LARGEST_CORRELATION)
    )


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


def rescaled(
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


def unseen(blocks: np.ndarray, shared: int, belief_slope: np.ndarray) -> np.ndarray:
    """Directions that neither data nor priors see, in columns.

    A coordinate's unit is what these would tell it to, were all others known.

    Args:
        blocks, shared: As for `covariance`.
        belief_slope: Derivative of each coordinate's prior residual; zero where it has none.
    """
    information = _information(blocks, shared) + np.diag(belief_slope**2)
    _, vectors, _, unseen = _directions(information)
    return vectors[:, unseen]


def each_alone(
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


def from_run_to_run(
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
    return np.array([spread_of(moves[told, k], errors[:, k]).variance for k in range(scattered)])


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


def inverse(information: np.ndarray) -> np.ndarray:
    """Its inverse; a direction without information gets a very large variance."""
    values, vectors, size, _ = _directions(information)
    root = vectors / np.sqrt(np.maximum(values, _floor(values))) / size[:, None]
    return root @ root.T


@dataclass(frozen=True, eq=False)
class Whitening:
    r"""Turns weighted residuals into numbers that scatter independently by one.

    A residual's covariance is its own inflated variance and, in each phase of the command, an
    unknown constant: $1 + u u^T$ with the constant's vector u. Along u that is $1 + u^T u$, across
    it 1, and so for every power of it.

    Attributes:
        scale: 1 / inflated standard deviation, zero where nothing counts, shape (runs, channels,
            samples).
        unit: u, shaped likewise, in every phase.
        phase: Number of each sample's phase, shape (runs, samples).
    """

    scale: np.ndarray
    unit: np.ndarray
    phase: np.ndarray

    def of_run(self, run: int) -> "Whitening":
        """That of one run alone."""
        here = np.s_[run : run + 1]
        return Whitening(self.scale[here], self.unit[here], self.phase[here])

    @classmethod
    def of(
        cls,
        residual: np.ndarray,
        counts: np.ndarray,
        offset: np.ndarray,
        phase: np.ndarray,
        intervals: np.ndarray,
    ) -> "Whitening":
        """The whitening of these residuals.

        Args:
            residual: Weighted, shape (runs, channels, samples).
            counts: True for samples that were compared, likewise.
            offset: Weighted residual that the simulation's own error makes, likewise.
            phase: Number of each sample's phase, shape (runs, samples).
            intervals: Usual intervals from the sample before, likewise.
        """
        number = np.maximum(counts.sum(axis=2), 1)
        inflation = np.maximum((residual**2).sum(axis=2) / number, FINEST_RUN**2)
        for run, channel in np.ndindex(inflation.shape):
            rho = lag_one_correlation(residual[run, channel], counts[run, channel], intervals[run])
            inflation[run, channel] *= (1 + rho) / (1 - rho)
        scale = counts / np.sqrt(inflation)[:, :, None]
        return cls(scale, offset * scale, phase)

    def apply(self, weighted: np.ndarray) -> np.ndarray:
        """Weighted residuals or derivatives, shape (runs, channels, samples, ...), whitened."""
        return self._stretched(weighted * self._beside(weighted, self.scale), -0.5)

    def colour(self, blocks: np.ndarray) -> np.ndarray:
        """Derivatives times the root of the noise's covariance: `apply` the other way."""
        spread = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)
        return self._stretched(blocks * self._beside(blocks, spread), 0.5)

    @staticmethod
    def _beside(values: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return scale.reshape(scale.shape + (1,) * (values.ndim - 3))

    def _stretched(self, values: np.ndarray, power: float) -> np.ndarray:
        """`values` with their part along u times (1 + u^T u) to this power, in every phase."""
        for run, phases in enumerate(self.phase):
            for here in (phases == number for number in np.unique(phases)):
                unit = self.unit[run][:, here]
                size = np.maximum(np.sum(unit**2, axis=1), np.finfo(float).tiny)
                part = ((1 + size) ** power - 1) / size
                along = np.einsum("cs,cs...->c...", unit, values[run][:, here])
                values[run][:, here] += np.einsum("c,cs,c...->cs...", part, unit, along)
        return values
