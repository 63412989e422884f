"""Slow and fast part of each channel's residual: the blocks that have a variance of their own.

With M the means over bins of `BIN_TIME` and P the lines through the bin means, the slow part of a
channel's samples y is M y, and the fast part y - P M y. Of travel the slow part is the difference
of successive bin means, as an error of speed would otherwise weigh on all bins that follow. A model
that misses one block by much says nothing of the others' noise.
"""

from dataclasses import dataclass

import numpy as np

# Length of the bins that separate slow from fast [s].
BIN_TIME = 0.5


KINDS = ("slow", "fast")


@dataclass(frozen=True)
class SlowFastSplit:
    """Linear maps from one run's samples to its blocks.

    Attributes:
        bin_means: M, means over bins, shape (bins, samples).
        interpolation: P, samples of the line through bin means, shape (samples, bins).
    """

    bin_means: np.ndarray
    interpolation: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray) -> "SlowFastSplit":
        """Maps for samples at some times [s], shape (samples,)."""
        place = np.floor((time - time[0]) / BIN_TIME + 1e-9).astype(int)
        used, place = np.unique(place, return_inverse=True)
        bins = len(used)
        mean = np.zeros((bins, len(time)))
        mean[place, np.arange(len(time))] = 1
        mean /= mean.sum(axis=1, keepdims=True)
        centre = mean @ time
        lines = np.stack([np.interp(time, centre, unit) for unit in np.eye(bins)], axis=1)
        return cls(mean, lines)

    def split(self, channel: str, values: np.ndarray) -> dict[str, np.ndarray]:
        """Slow and fast part of some columns of samples.

        Args:
            channel: Name of the channel.
            values: Shape (samples, columns).

        Returns:
            By kind, shape (bins, columns), one fewer of travel, and (samples, columns).
        """
        with np.errstate(invalid="ignore"):  # a run that could not be simulated has no numbers
            means = self.bin_means @ values
            fast = values - self.interpolation @ means
        slow = np.diff(means, axis=0) if channel == "x" else means
        return {"slow": slow, "fast": fast}
