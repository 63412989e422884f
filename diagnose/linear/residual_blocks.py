"""Residuals cut into blocks that fail in their own ways: slow and fast, channel by channel.

The slow part of a position reading is its mean over half a second (of travel: how that changes
from one to the next, since an error of speed would otherwise weigh on all that follows); the fast
part is what is left. A model that misses one block by much says nothing of the others' noise, so
each block has a variance of its own.
"""

from dataclasses import dataclass

import numpy as np

# Length of the bins [s] that part slow from fast.
BIN_TIME = 0.5


KINDS = ("slow", "fast")


@dataclass(frozen=True)
class SlowFastSplit:
    """Linear maps from one run's samples to its blocks.

    Attributes:
        mean: Bin means from samples, shape (bins, samples).
        back: Samples of the line through the bin means, shape (samples, bins).
    """

    bin_means: np.ndarray
    interpolation: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray) -> "SlowFastSplit":
        """For samples at these times [s]."""
        place = np.floor((time - time[0]) / BIN_TIME + 1e-9).astype(int)
        used, place = np.unique(place, return_inverse=True)
        bins = len(used)
        mean = np.zeros((bins, len(time)))
        mean[place, np.arange(len(time))] = 1
        mean /= mean.sum(axis=1, keepdims=True)
        centre = mean @ time
        back = np.stack([np.interp(time, centre, unit) for unit in np.eye(bins)], axis=1)
        return cls(mean, back)

    def split(self, channel: str, values: np.ndarray) -> dict[str, np.ndarray]:
        """Slow and fast part of columns of samples, shape (samples, columns)."""
        means = self.bin_means @ values
        fast = values - self.interpolation @ means
        slow = np.diff(means, axis=0) if channel == "x" else means
        return {"slow": slow, "fast": fast}
