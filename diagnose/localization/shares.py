"""The gap cut by an axis: how much of it lies in each bin, and how sure that is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.localization.kinematics import RunKinematics

# Intervals hold the share with this probability.
PROBABILITY = 0.9


DRAWS = 400


SEED = 20240


@dataclass(frozen=True)
class GapShare:
    """Share of the gap in one bin of one axis.

    Attributes:
        axis: What the gap is cut by.
        label: The bin, with its unit.
        share: Of the squared residual over time, in units of the floor [-].
        interval: That holds it with a probability of 90 %.
        time: Share of the time spent there; NaN where that means nothing.
    """

    axis: str
    label: str
    share: float
    interval: tuple[float, float]
    time: float = np.nan


@dataclass(frozen=True, eq=False)
class RunMisfit:
    """One run's error.

    Attributes:
        motion: How it moved.
        error: In floors, shape (channels, samples); zero where not recorded.
        spacing: Time that a sample stands for [s].
    """

    motion: RunKinematics
    error: np.ndarray
    spacing: float

    @property
    def power(self) -> np.ndarray:
        """Of every sample, over channels."""
        return (self.error**2).sum(axis=0)

    @property
    def whole(self) -> float:
        """Power over time [s]."""
        return self.spacing * float(self.power.sum())

    def in_bins(self, place: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`values` (rows, samples) over the time of half seconds, shape (half seconds, rows)."""
        count = int(self.motion.bins.max()) + 1
        sums = np.stack([np.bincount(place, row, count) for row in values], axis=1)
        return self.spacing * sums


@dataclass(frozen=True, eq=False)
class Partition:
    """An axis: by run, power over time, and time, of each half second in each bin of it."""

    axis: str
    labels: Sequence[str]
    power: list[np.ndarray]
    time: list[np.ndarray] | None = None


def partition_by_bin(
    runs: Sequence[RunMisfit], axis: str, labels: Sequence[str], places: Sequence[np.ndarray]
) -> Partition:
    """An axis by the number of each sample's bin."""
    power, time = [], []
    for run, place in zip(runs, places, strict=True):
        inside = (place == np.arange(len(labels))[:, None]).astype(float)
        power.append(run.in_bins(run.motion.bins, inside * run.power))
        time.append(run.in_bins(run.motion.bins, inside))
    return Partition(axis, labels, power, time)


def partition_by_label(runs: Sequence[RunMisfit], axis: str, names: Sequence[str]) -> Partition:
    """An axis by a name of each run."""
    labels = list(dict.fromkeys(names))
    places = [
        np.full(len(run.motion.time), labels.index(name))
        for run, name in zip(runs, names, strict=True)
    ]
    return partition_by_bin(runs, axis, labels, places)


def bootstrap_counts(random: np.random.Generator, sizes: list[int], groups: Sequence) -> np.ndarray:
    """How often each half second is drawn, shape (draws, half seconds of all runs).

    Runs are drawn from their group, as many as it has; half seconds from each run drawn.

    Args:
        random: Where the lots come from.
        sizes: Half seconds of each run.
        groups: What each run stands for.
    """
    times = np.zeros((DRAWS, len(sizes)), int)
    # In the order of the runs: a set of names has another one in every process.
    for group in dict.fromkeys(groups):
        members = [k for k, each in enumerate(groups) if each == group]
        even = np.full(len(members), 1 / len(members))
        times[:, members] = random.multinomial(len(members), even, size=DRAWS)
    parts = [
        random.multinomial(times[:, k] * size, np.full(size, 1 / size))
        for k, size in enumerate(sizes)
    ]
    return np.concatenate(parts, axis=1).astype(float)


def shares_of(cut: Partition, draws: np.ndarray, total: float) -> list[GapShare]:
    """The share of every bin, with its interval; bins where no time was spent are left out.

    Args:
        cut: The axis.
        draws: By `drawn_anew`, shape (draws, half seconds of all runs).
        total: The whole gap, squared error in floors over time [s]: a draw of next to nothing of it
            tells nothing.
    """
    power = np.concatenate(cut.power)
    share = power.sum(axis=0) / power.sum()
    drawn = draws @ power
    whole = drawn.sum(axis=1, keepdims=True)
    drawn = np.where(whole > 1e-12 * total, drawn / np.maximum(whole, 1e-300), share)
    tail = 50 * (1 - PROBABILITY)
    low, high = np.percentile(drawn, [tail, 100 - tail], axis=0)
    time = np.full(len(share), np.nan)
    if cut.time is not None:
        spent = np.concatenate(cut.time).sum(axis=0)
        time = spent / spent.sum()
    return [
        GapShare(
            cut.axis,
            label,
            float(share[k]),
            (float(min(low[k], share[k])), float(max(high[k], share[k]))),
            float(time[k]),
        )
        for k, label in enumerate(cut.labels)
        if cut.time is None or time[k] > 0
    ]


# What a sentence names holds this share of the gap at least, what is most of it that; and how many
# it names at most.
LEAST_TOLD, MOST, MOST_TOLD = 0.25, 0.5, 3
