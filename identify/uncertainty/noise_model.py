"""How residuals scatter: what a fit takes for chance."""

import abc

import equinox as eqx
import numpy as np

from identify.solver.whitening import lag_one_correlation

# A residual that follows itself more closely than this is a model's error, not a noise; whitened
# by more, slow misfits, which are what a fit is made on, would no longer count.
LARGEST_CORRELATION = 0.95


class AbstractNoise(eqx.Module):
    """A model of the residuals of one channel over all runs."""

    @abc.abstractmethod
    def correlation(
        self, residual: np.ndarray, counts: np.ndarray, intervals: np.ndarray
    ) -> np.ndarray:
        """Correlation with the sample before [-] that a fit whitens by, shape (channels,).

        Args:
            residual: Simulated minus recorded, shape (runs, channels, samples).
            counts: True for samples that were compared, likewise.
            intervals: Usual intervals from the sample before, shape (runs, samples).
        """


class White(AbstractNoise):
    """Samples scatter independently. Standard errors are widened by what correlation is left."""

    def correlation(
        self, residual: np.ndarray, counts: np.ndarray, intervals: np.ndarray
    ) -> np.ndarray:
        return np.zeros(residual.shape[1])


class Autoregressive(AbstractNoise):
    """First order: each sample carries on a share of the last one's error, one share a channel."""

    def correlation(
        self, residual: np.ndarray, counts: np.ndarray, intervals: np.ndarray
    ) -> np.ndarray:
        runs, channels, _ = residual.shape
        weights = counts.sum(axis=2)
        each = np.array(
            [
                [
                    lag_one_correlation(residual[r, c], counts[r, c], intervals[r])
                    for c in range(channels)
                ]
                for r in range(runs)
            ]
        )
        pooled = (each * weights).sum(axis=0) / np.maximum(weights.sum(axis=0), 1)
        return np.minimum(pooled, LARGEST_CORRELATION)
