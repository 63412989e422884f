"""Whitening of residuals that are correlated in time."""

from dataclasses import dataclass

import numpy as np

from identify.solver.abstract_noise import AbstractNoise

# Beyond this the inflation is no longer an estimate but a statement that the samples are one.
LARGEST_CORRELATION = 0.9999


# Residuals of a run are taken for no finer than this share of what its channel is weighed by: what
# few samples leave, or a simulation fitted to itself, is no noise.
FINEST_RUN = 0.1


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
        noise: AbstractNoise,
    ) -> "Whitening":
        """The whitening of these residuals.

        Args:
            residual: Weighted, shape (runs, channels, samples).
            counts: True for samples that were compared, likewise.
            offset: Weighted residual that the simulation's own error makes, likewise.
            phase: Number of each sample's phase, shape (runs, samples).
            intervals: Usual intervals from the sample before, likewise.
            noise: Model of the scatter.
        """
        number = np.maximum(counts.sum(axis=2), 1)
        inflation = np.maximum((residual**2).sum(axis=2) / number, FINEST_RUN**2)
        for run, channel in np.ndindex(inflation.shape):
            here = run, channel
            inflation[here] *= noise.inflation(residual[here], counts[here], intervals[run])
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
