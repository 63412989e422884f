r"""Shares of the gap in the bins of an axis, with bootstrap intervals.

The gap is the integral over time of the squared residual in noise floors, summed over channels,
$\sum_c \int (r_c / n_c)^2 \mathrm{d}t$. A bin's share is the part of it from the times at which a
run was in that bin; its interval comes from drawing half seconds (and runs of a group) with
replacement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.localization.kinematics import RunKinematics
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings


@dataclass(frozen=True)
class GapShare:
    """Share of the gap in one bin of one axis.

    Attributes:
        axis: Name of the axis.
        label: The bin, with its unit.
        share: Of the squared residual over time, in noise floors squared [-].
        interval: Its bounds with a probability of 90 %.
        time: Share of the time spent in the bin [-]; NaN where that has no meaning.
    """

    axis: str
    label: str
    share: float
    interval: tuple[float, float]
    time: float = np.nan


@dataclass(frozen=True, eq=False)
class RunMisfit:
    """Residual of one run, and its motion.

    Attributes:
        motion: Kinematics of the run.
        residual: In noise floors, shape (channels, samples); zero where not recorded.
        spacing: Time between samples [s].
    """

    motion: RunKinematics
    residual: np.ndarray
    spacing: float

    @property
    def power(self) -> np.ndarray:
        """Squared residual of every sample, summed over channels, shape (samples,)."""
        return (self.residual**2).sum(axis=0)

    @property
    def whole(self) -> float:
        """Integral of the power over time [s]."""
        return self.spacing * float(self.power.sum())

    def in_bins(self, place: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Integrals over time of values in each half second.

        Args:
            place: Index of the half second of each value, shape (values,).
            values: Shape (rows, values).

        Returns:
            Shape (half seconds, rows).
        """
        count = int(self.motion.bins.max()) + 1
        sums = np.stack([np.bincount(place, row, count) for row in values], axis=1)
        return self.spacing * sums


@dataclass(frozen=True, eq=False)
class Partition:
    """The gap divided into the bins of an axis.

    Attributes:
        axis: Name of the axis.
        labels: Of its bins.
        power: By run, integral of the power in each half second and bin [s], shape (half seconds,
            bins).
        time: The same of the time spent there [s]; None where that has no meaning.
    """

    axis: str
    labels: Sequence[str]
    power: list[np.ndarray]
    time: list[np.ndarray] | None = None


def partition_by_bin(
    runs: Sequence[RunMisfit], axis: str, labels: Sequence[str], places: Sequence[np.ndarray]
) -> Partition:
    """Partition by the bin of each sample.

    Args:
        runs: The runs.
        axis: Name of the axis.
        labels: Of its bins.
        places: By run, index of each sample's bin, shape (samples,).
    """
    power, time = [], []
    for run, place in zip(runs, places, strict=True):
        inside = (place == np.arange(len(labels))[:, None]).astype(float)
        power.append(run.in_bins(run.motion.bins, inside * run.power))
        time.append(run.in_bins(run.motion.bins, inside))
    return Partition(axis, labels, power, time)


def partition_by_label(runs: Sequence[RunMisfit], axis: str, names: Sequence[str]) -> Partition:
    """Partition by a name of each run."""
    labels = list(dict.fromkeys(names))
    places = [
        np.full(len(run.motion.time), labels.index(name))
        for run, name in zip(runs, names, strict=True)
    ]
    return partition_by_bin(runs, axis, labels, places)


def bootstrap_counts(
    random: np.random.Generator,
    sizes: list[int],
    groups: Sequence,
    draws: int = DEFAULT_LOCALIZATION.draws,
) -> np.ndarray:
    """Number of times that each half second is drawn, shape (draws, half seconds of all runs).

    Runs are drawn from their group, as many as it has; half seconds from each run drawn.

    Args:
        random: Generator of the draws.
        sizes: Half seconds of each run.
        groups: Key of each run's group.
        draws: Number of draws.
    """
    times = np.zeros((draws, len(sizes)), int)
    # In the order of the runs: a set of names has another one in every process.
    for group in dict.fromkeys(groups):
        members = [k for k, each in enumerate(groups) if each == group]
        even = np.full(len(members), 1 / len(members))
        times[:, members] = random.multinomial(len(members), even, size=draws)
    parts = [
        random.multinomial(times[:, k] * size, np.full(size, 1 / size))
        for k, size in enumerate(sizes)
    ]
    return np.concatenate(parts, axis=1).astype(float)


def interval_of(
    drawn: np.ndarray, share: float, settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> tuple[float, float]:
    """Interval of a share from its bootstrap draws, which holds the share itself.

    Args:
        drawn: Shares of the draws [-], shape (draws,).
        share: Of all runs [-].
        settings: Probability of the interval.
    """
    tail = 50 * (1 - settings.probability)
    low, high = np.percentile(drawn, [tail, 100 - tail])
    return float(min(low, share)), float(max(high, share))


def shares_of(
    partition: Partition,
    draws: np.ndarray,
    total: float,
    settings: LocalizationSettings = DEFAULT_LOCALIZATION,
) -> list[GapShare]:
    """Share of every bin, with its interval; bins in which no time was spent are left out.

    Args:
        partition: The axis.
        draws: By `bootstrap_counts`, shape (draws, half seconds of all runs).
        total: The whole gap [s]: a draw of next to nothing of it counts as the share of all runs.
        settings: Probability of the intervals.
    """
    power = np.concatenate(partition.power)
    share = power.sum(axis=0) / power.sum()
    drawn = draws @ power
    whole = drawn.sum(axis=1, keepdims=True)
    drawn = np.where(whole > 1e-12 * total, drawn / np.maximum(whole, 1e-300), share)
    time = np.full(len(share), np.nan)
    if partition.time is not None:
        spent = np.concatenate(partition.time).sum(axis=0)
        time = spent / spent.sum()
    return [
        GapShare(
            partition.axis,
            label,
            float(share[k]),
            interval_of(drawn[:, k], float(share[k]), settings),
            float(time[k]),
        )
        for k, label in enumerate(partition.labels)
        if partition.time is None or time[k] > 0
    ]
