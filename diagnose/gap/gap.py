"""Gap per channel, and the share of its part above the noise floor that a model removes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from drftjax.recorded.repeats import group_by_condition

MM_PER_M = 1e3

# Seed of the draws of intervals: fixed, so that the same runs give the same interval.
INTERVAL_SEED = 0


@dataclass(frozen=True)
class GapSettings:
    """Numbers of a gap and its interval.

    Attributes:
        min_excess: A gap that exceeds its noise floor by less than this share of it [-] cannot be
            said to shrink.
        draws: Bootstrap draws of an interval.
        conditions_per_draw: Conditions in each draw. An interval is of what so many more runs would
            show: a few, each with a command and load of its own.
        probability: Of the interval [-].
    """

    min_excess: float = 0.5
    draws: int = 400
    conditions_per_draw: int = 3
    probability: float = 0.9


DEFAULT_GAP = GapSettings()


def is_reducible(before: float, floor: float, settings: GapSettings = DEFAULT_GAP) -> bool:
    """True where a gap lies far enough above its noise floor to say by how much it shrinks.

    Args:
        before, floor: In one unit.
        settings: Numbers of a gap.
    """
    return before - floor > settings.min_excess * floor


def share_removed(before: float, after: float, floor: float) -> float:
    r"""Share of a gap above its noise floor that a model removes [-].

    $(g - \max(g', n)) / (g - n)$ with the gap g before, g' after and the noise floor n; -1 at
    least, and zero where nothing lies above the floor.

    Args:
        before, after, floor: In one unit.
    """
    excess = before - floor
    if excess <= 0:
        return 0.0
    return max(-1.0, (before - max(after, floor)) / excess)


def shrinkage(
    before: float, after: float, floor: float, settings: GapSettings = DEFAULT_GAP
) -> float:
    """`share_removed`; zero where the gap is not reducible."""
    return share_removed(before, after, floor) if is_reducible(before, floor, settings) else 0.0


@dataclass(frozen=True)
class Gap:
    """The gap in one channel, in SI units.

    Attributes:
        before, after: RMS residual of the reference model and of the one with the effect, on runs
            that were held out of its fit [m, N, N m].
        floor: Noise floor, in the same unit.
        shrinkage: Share of the gap above the floor that the effect removes [-].
        interval: Bounds of it on a few more runs, with a probability of 90 %, over draws in which
            the gap is reducible. None for runs of one condition, which do not show how another one
            differs.
        settings: Numbers that it was judged by.
    """

    before: float
    after: float
    floor: float
    shrinkage: float
    interval: tuple[float, float] | None
    settings: GapSettings = DEFAULT_GAP

    @property
    def is_reducible(self) -> bool:
        """True where it lies far enough above the floor to say by how much it shrinks."""
        return is_reducible(self.before, self.floor, self.settings)

    def document(self) -> dict:
        """Plain values; lengths in mm."""
        return {
            "before_mm": self.before * MM_PER_M,
            "after_mm": self.after * MM_PER_M,
            "floor_mm": self.floor * MM_PER_M,
            "shrinkage": self.shrinkage,
            "shrinkage_interval": None if self.interval is None else list(self.interval),
        }


def gaps(
    dataset: RigDataset,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    floors: Mapping[str, float],
    settings: GapSettings = DEFAULT_GAP,
) -> dict[str, Gap]:
    """Gap in every channel, with an interval by bootstrap over conditions.

    A run counts by its duration, however often it was sampled.

    Args:
        dataset: The runs.
        before, after: Residuals of each run, shape (channels, samples); `after` of held-out runs.
        floors: Noise floor of each channel [m, N, N m].
        settings: Numbers of a gap.
    """
    groups = group_by_condition(dataset.runs)
    generator = np.random.default_rng(INTERVAL_SEED)
    draws = generator.integers(0, len(groups), (settings.draws, settings.conditions_per_draw))
    found = {}
    for index, channel in enumerate(dataset.channels):
        sums = np.array([_sums(dataset, group, index, before, after) for group in groups])
        # In the order of what they show: draws must not depend on how files are named.
        sums = sums[np.lexsort(sums.T)]
        rms_before, rms_after = _rms(sums)
        floor = floors[channel]
        share = shrinkage(rms_before, rms_after, floor, settings)
        interval = None
        if len(groups) > 1:
            interval = _interval(share, (rms_before, rms_after), sums[draws], floor, settings)
        found[channel] = Gap(rms_before, rms_after, floor, share, interval, settings)
    return found


def _sums(
    dataset: RigDataset,
    runs: Sequence[int],
    index: int,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
) -> np.ndarray:
    """Integrals over time of (before², after², 1) in one channel of some runs, shape (3,)."""
    total = np.zeros(3)
    for run in runs:
        recorded = np.isfinite(before[run][index])
        squares = [(each[run][index][recorded] ** 2).sum() for each in (before, after)]
        total += dataset.sample_interval(run) * np.array([*squares, recorded.sum()])
    return total


def _rms(sums: np.ndarray) -> tuple[float, float]:
    """Root mean squares before and after, over rows of `_sums`, shape (conditions, 3)."""
    total = sums.sum(axis=0)
    before, after = np.sqrt(total[:2] / (total[2] or 1.0))
    return float(before), float(after)


def _interval(
    share: float,
    gap: tuple[float, float],
    drawn: np.ndarray,
    floor: float,
    settings: GapSettings,
) -> tuple[float, float]:
    """Interval of the share removed, which holds the share of all runs.

    Args:
        share: Of all runs [-].
        gap: Of all runs, before and after.
        drawn: Rows of `_sums`, shape (draws, conditions, 3).
        floor: Noise floor.
        settings: Numbers of a gap.
    """
    before, after = gap
    if before == after:  # the reference model removes nothing, whatever the runs
        return share, share
    # A gap below the floor is chance, which on other runs will be as large as the floor.
    scale = max(1.0, floor / after) if after > 0 else 1.0
    shares = [
        share_removed(first, scale * last, floor)
        for first, last in map(_rms, drawn)
        if is_reducible(first, floor, settings)
    ]
    tail = (1 - settings.probability) / 2
    low, high = np.quantile(shares or [share], [tail, 1 - tail])
    return min(float(low), share), max(float(high), share)
