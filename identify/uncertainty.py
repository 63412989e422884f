"""Standard errors of fitted coordinates, honest about residuals that follow one another."""

from dataclasses import dataclass

import numpy as np

from identify.solve import normal_equations

# Beyond this the inflation is no longer an estimate but a statement that the samples are one.
LARGEST_CORRELATION = 0.9999


def lag_one_correlation(residual: np.ndarray, counts: np.ndarray) -> float:
    """Correlation of a residual with its neighbour [-], over the samples that count."""
    both = counts[1:] & counts[:-1]
    power = np.sum(residual[counts] ** 2)
    if power == 0 or not both.any():
        return 0.0
    scale = counts.sum() / both.sum()
    return float(
        np.clip(scale * np.sum(residual[1:] * residual[:-1] * both) / power, 0, LARGEST_CORRELATION)
    )


def covariance(
    residual: np.ndarray,
    blocks: np.ndarray,
    counts: np.ndarray,
    shared: int,
    belief_slope: np.ndarray,
    offset: np.ndarray,
    phase: np.ndarray,
) -> np.ndarray:
    """Covariance of (shared, run 1's own, run 2's own, ...) coordinates.

    The residual of each run and channel is taken as first-order autoregressive: its variance is
    measured, and (1 + rho) / (1 - rho) samples count as one. Beyond that the simulation itself may
    be off by a constant in every phase of the command, which no number of samples averages away.
    A direction that the data do not see gets a very large variance.

    Args:
        residual: Weighted residuals at the optimum, shape (runs, channels, samples).
        blocks: Their derivative by (shared, own) coordinates, shape (..., shared + own).
        counts: True for samples that were recorded, shape (runs, channels, samples).
        shared: Number of shared coordinates.
        belief_slope: Derivative of each coordinate's prior residual; zero where it has none.
        offset: Weighted residual that one standard deviation of such a constant makes, shape
            (runs, channels, samples).
        phase: Number of each sample's phase, shape (runs, samples).

    Returns:
        Covariance, shape (shared + runs * own,) squared.
    """
    whitening = Whitening.of(residual, counts, offset, phase)
    information, _ = normal_equations(whitening.apply(blocks), shared, residual)
    return inverse(information + np.diag(belief_slope**2))


def inverse(information: np.ndarray) -> np.ndarray:
    """Its inverse; a direction without information gets a very large variance."""
    values, vectors = np.linalg.eigh(information)
    size = len(information)
    floor = values.max() * np.finfo(float).eps * size if size else 0.0
    return (vectors / np.maximum(values, max(floor, np.finfo(float).tiny))) @ vectors.T


@dataclass(frozen=True, eq=False)
class Whitening:
    r"""Turns weighted residuals into numbers that scatter independently by one.

    A residual's covariance is its own inflated variance and, in each phase of the command, an
    unknown constant: $1 + u u^T$ with the constant's vector u. Its inverse is the square of
    $1 - a u u^T$ with $a = (1 - 1 / \sqrt{1 + u^T u}) / u^T u$.

    Attributes:
        scale: 1 / inflated standard deviation, zero where nothing counts, shape (runs, channels,
            samples).
        unit: u, shaped likewise, in every phase.
        phase: Number of each sample's phase, shape (runs, samples).
    """

    scale: np.ndarray
    unit: np.ndarray
    phase: np.ndarray

    @classmethod
    def of(
        cls, residual: np.ndarray, counts: np.ndarray, offset: np.ndarray, phase: np.ndarray
    ) -> "Whitening":
        """The whitening of these residuals; arguments as for `covariance`."""
        number = np.maximum(counts.sum(axis=2), 1)
        inflation = np.maximum((residual**2).sum(axis=2) / number, 1.0)
        for run, channel in np.ndindex(inflation.shape):
            rho = lag_one_correlation(residual[run, channel], counts[run, channel])
            inflation[run, channel] *= (1 + rho) / (1 - rho)
        scale = counts / np.sqrt(inflation)[:, :, None]
        return cls(scale, offset * scale, phase)

    def apply(self, weighted: np.ndarray) -> np.ndarray:
        """Weighted residuals or derivatives, shape (runs, channels, samples, ...), whitened."""
        white = weighted * self.scale.reshape(self.scale.shape + (1,) * (weighted.ndim - 3))
        for run, phases in enumerate(self.phase):
            for here in (phases == number for number in np.unique(phases)):
                unit = self.unit[run][:, here]
                power = np.maximum(np.sum(unit**2, axis=1), np.finfo(float).tiny)
                part = (1 - 1 / np.sqrt(1 + power)) / power
                along = np.einsum("cs,cs...->c...", unit, white[run][:, here])
                white[run][:, here] -= np.einsum("c,cs,c...->cs...", part, unit, along)
        return white
