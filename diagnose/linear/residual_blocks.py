"""Slow part, fast part and level of residuals: the blocks that have a variance of their own.

With M the means over bins of `BIN_TIME` and P the lines through the bin means, the slow part of a
channel's samples y is M y, and the fast part y - P M y. Of travel the slow part is the difference
of successive bin means, as an error of speed would otherwise weigh on all bins that follow. A model
that misses one block by much says nothing of the others' noise.

The level of x and z is the mean of a run's samples: one statement. A speed that is wrong by a
thousandth hides in the differences of bins, and in the zeta of the run if that may bend the mean
sinkage by some micrometres; it shows in the level of x at the zeta that the level of z asks for.
Clocks of two programs, or of a command and its readings, agree to a millisecond or two, in which a
wheel goes on by that times its speed: the level of x of a run is told in units that grow with it.
"""

from dataclasses import dataclass

import numpy as np

# Length of the bins that separate slow from fast [s].
BIN_TIME = 0.5

# Channels whose mean over a run is a block of its own.
LEVELLED = ("x", "z")

# What a model misses the level of x by where it is right [m]; what clocks are apart [s]: runs of
# another program without an effect are 1.3 to 1.5 ms late.
PLACE_ERROR, CLOCK_ERROR = 85e-6, 1.8e-3


def level_share(speed: float) -> float:
    """Share that the level of x of a run counts by [-], one where the wheel ends where it began.

    Args:
        speed: Mean speed of the wheel centre over the run [m/s].
    """
    return PLACE_ERROR / float(np.hypot(PLACE_ERROR, CLOCK_ERROR * speed))


def kinds_of(channel: str) -> tuple[str, ...]:
    """Kinds of the blocks that a channel has."""
    return ("slow", "fast", "level") if channel in LEVELLED else ("slow", "fast")


@dataclass(frozen=True)
class SlowFastSplit:
    """Linear maps from one run's samples to its blocks.

    Attributes:
        bin_means: M, means over bins, shape (bins, samples).
        interpolation: P, samples of the line through bin means, shape (samples, bins).
        travel_share: Share that the level of x counts by [-], see `level_share`.
    """

    bin_means: np.ndarray
    interpolation: np.ndarray
    travel_share: float = 1.0

    @classmethod
    def of(cls, time: np.ndarray, speed: float = 0.0) -> "SlowFastSplit":
        """Maps for the samples of a run.

        Args:
            time: Times of the samples [s], shape (samples,).
            speed: Mean speed of the wheel centre [m/s].
        """
        place = np.floor((time - time[0]) / BIN_TIME + 1e-9).astype(int)
        used, place = np.unique(place, return_inverse=True)
        bins = len(used)
        mean = np.zeros((bins, len(time)))
        mean[place, np.arange(len(time))] = 1
        mean /= mean.sum(axis=1, keepdims=True)
        centre = mean @ time
        lines = np.stack([np.interp(time, centre, unit) for unit in np.eye(bins)], axis=1)
        return cls(mean, lines, level_share(speed))

    def split(self, channel: str, values: np.ndarray) -> dict[str, np.ndarray]:
        """The blocks of some columns of samples.

        Args:
            channel: Name of the channel.
            values: Shape (samples, columns).

        Returns:
            By kind, as `kinds_of` has them: slow, shape (bins, columns), one fewer of travel; fast,
            shape (samples, columns); level, shape (1, columns), of x times its share.
        """
        with np.errstate(invalid="ignore"):  # a run that could not be simulated has no numbers
            means = self.bin_means @ values
            fast = values - self.interpolation @ means
            level = values.mean(axis=0, keepdims=True)
        slow = np.diff(means, axis=0) if channel == "x" else means
        level = level * self.travel_share if channel == "x" else level
        every = {"slow": slow, "fast": fast, "level": level}
        return {kind: every[kind] for kind in kinds_of(channel)}
