"""Whitening of residuals that are correlated in time."""

from dataclasses import dataclass, replace

import numpy as np

from identify.solver.abstract_noise import AbstractNoise

# Beyond this correlation the inflation is no estimate: all samples count as one.
LARGEST_CORRELATION = 0.9999


def lag_one_correlation(residual: np.ndarray, counts: np.ndarray, intervals: np.ndarray) -> float:
    """Return the correlation of a residual with its neighbour [-], over the samples that count.

    Args:
        residual, counts: Of one channel of a run, shape (samples,).
        intervals: Usual intervals from the sample before [-]; neighbours are one apart.
    """
    both = counts[1:] & counts[:-1] & (intervals[1:] == 1)
    power = np.sum(residual[counts] ** 2)
    if power == 0 or not both.any():
        return 0.0
    scale = counts.sum() / both.sum()
    return float(
        np.clip(scale * np.sum(residual[1:] * residual[:-1] * both) / power, 0, LARGEST_CORRELATION)
    )


@dataclass(frozen=True, eq=False)
class Whitening:
    r"""Linear map from weighted residuals to independent numbers of unit variance.

    The covariance of scaled residuals is $1 + u u^T$ in each phase of the command: an inflated
    variance of each, and an unknown constant of the simulation's own error with vector u. Its
    eigenvalue is $1 + u^T u$ along u and 1 across it, which gives every power of it.

    Attributes:
        scale: 1 / inflated standard deviation, zero where nothing counts, shape (runs, channels,
            samples).
        unit: u, shaped likewise, in every phase.
        phase: Number of each sample's phase, shape (runs, samples).
        finest: Smallest residual of a run, as a share of its channel's weight [-]: what few samples
            leave, or a simulation fitted to itself, is no noise.
    """

    scale: np.ndarray
    unit: np.ndarray
    phase: np.ndarray
    finest: float = 0.1

    def of_run(self, run: int) -> "Whitening":
        """Return the whitening of one run."""
        here = np.s_[run : run + 1]
        return replace(self, scale=self.scale[here], unit=self.unit[here], phase=self.phase[here])

    @classmethod
    def of(
        cls,
        residual: np.ndarray,
        counts: np.ndarray,
        offset: np.ndarray,
        phase: np.ndarray,
        intervals: np.ndarray,
        noise: AbstractNoise,
        finest: float = 0.1,
    ) -> "Whitening":
        """Return the whitening of residuals like these.

        Args:
            residual: Weighted, shape (runs, channels, samples).
            counts: True for samples that were compared, likewise.
            offset: Weighted residual that the simulation's own error makes, likewise.
            phase: Number of each sample's phase, shape (runs, samples).
            intervals: Usual intervals from the sample before, likewise.
            noise: Model of the scatter.
            finest: See `Whitening`.
        """
        number = np.maximum(counts.sum(axis=2), 1)
        inflation = np.maximum((residual**2).sum(axis=2) / number, finest**2)
        for run, channel in np.ndindex(inflation.shape):
            here = run, channel
            inflation[here] *= noise.inflation(residual[here], counts[here], intervals[run])
        scale = counts / np.sqrt(inflation)[:, :, None]
        return cls(scale, offset * scale, phase, finest)

    def apply(self, weighted: np.ndarray) -> np.ndarray:
        """Return weighted residuals or derivatives (runs, channels, samples, ...), whitened."""
        return self._scale_along_unit(weighted * self._broadcast(weighted, self.scale), -0.5)

    def colour(self, blocks: np.ndarray) -> np.ndarray:
        """Return values times the root of the noise's covariance: the inverse of `apply`."""
        spread = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.scale > 0)
        return self._scale_along_unit(blocks * self._broadcast(blocks, spread), 0.5)

    @staticmethod
    def _broadcast(values: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return scale.reshape(scale.shape + (1,) * (values.ndim - 3))

    def _scale_along_unit(self, values: np.ndarray, power: float) -> np.ndarray:
        """Return `values` with their part along u times (1 + u^T u)^power, in every phase."""
        for run, phases in enumerate(self.phase):
            for here in (phases == number for number in np.unique(phases)):
                unit = self.unit[run][:, here]
                size = np.maximum(np.sum(unit**2, axis=1), np.finfo(float).tiny)
                part = ((1 + size) ** power - 1) / size
                along = np.einsum("cs,cs...->c...", unit, values[run][:, here])
                values[run][:, here] += np.einsum("c,cs,c...->cs...", part, unit, along)
        return values
