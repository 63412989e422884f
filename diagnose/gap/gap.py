"""The gap before and after, and the share of it above the noise floor that a model removes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from drftjax.recorded.repeats import group_by_condition

# A gap that exceeds its floor by less than this share of it cannot be said to shrink.
LEAST_REACHABLE = 0.5


def is_reducible(before: float, floor: float) -> bool:
    """Whether a gap lies far enough above its floor, both in one unit."""
    return before - floor > LEAST_REACHABLE * floor


def share_removed(before: float, after: float, floor: float) -> float:
    """Share of a gap above its floor that is gone [-], -1 at least; zero where none is above it."""
    reachable = before - floor
    if reachable <= 0:
        return 0.0
    return max(-1.0, (before - max(after, floor)) / reachable)


DRAWS = 400


LEVEL = 0.9


# An interval is of what so many runs more would show: a few, each of a command and load of its own.
FRESH = 3


MM = 1e3


@dataclass(frozen=True)
class Gap:
    """The gap in one channel, in SI units.

    Attributes:
        before, after: RMSE of the reference model and of the one with the effect, on runs left
            out while it was fitted [m, N, N m].
        floor: Noise floor.
        shrinkage: Share of what could be reached above the floor that the effect removes [-].
        interval: Where it lies with 90 % on a few runs more; of draws in which a gap could shrink.
            None of runs of one condition, which do not tell how another one differs.
    """

    before: float
    after: float
    floor: float
    shrinkage: float
    interval: tuple[float, float] | None

    @property
    def is_reducible(self) -> bool:
        """Whether it lies far enough above the floor to say by how much it shrinks."""
        return is_reducible(self.before, self.floor)

    def document(self) -> dict:
        """Plain values; lengths in mm."""
        return {
            "before_mm": self.before * MM,
            "after_mm": self.after * MM,
            "floor_mm": self.floor * MM,
            "shrinkage": self.shrinkage,
            "shrinkage_interval": None if self.interval is None else list(self.interval),
        }


def shrinkage(before: float, after: float, floor: float) -> float:
    """Share of the RMSE above the floor that is gone; zero where none could go."""
    return share_removed(before, after, floor) if is_reducible(before, floor) else 0.0


def gaps(
    case: RigDataset,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    floors: Mapping[str, float],
) -> dict[str, Gap]:
    """The gap in every channel, with intervals by drawing a few conditions anew.

    A run counts by how long it is, however often it was sampled.

    Args:
        case: The runs.
        before, after: Residuals of each run, shape (channels, samples); `after` of runs left out.
        floors: Noise floor of each channel.
    """
    groups = group_by_condition(case.runs)
    generator = np.random.default_rng(0)
    draws = generator.integers(0, len(groups), (DRAWS, FRESH))
    found = {}
    for index, channel in enumerate(case.channels):
        power = np.zeros((len(groups), 3))
        for number, group in enumerate(groups):
            for run in group:
                counts = np.isfinite(before[run][index])
                power[number] += case.sample_interval(run) * np.array(
                    [
                        (before[run][index][counts] ** 2).sum(),
                        (after[run][index][counts] ** 2).sum(),
                        counts.sum(),
                    ]
                )
        # Drawn by what they show, not by how their files are called.
        power = power[np.lexsort(power.T)]
        floor = floors[channel]

        def of(rows: np.ndarray) -> tuple[float, float]:
            total = rows.sum(axis=0)
            first, last = np.sqrt(total[:2] / (total[2] or 1.0))
            return float(first), float(last)

        first, last = of(power)
        share = shrinkage(first, last, floor)
        # What is left below the floor is chance, and elsewhere will be as large as the floor.
        chance = max(1.0, floor / last) if last > 0 else 1.0
        drawn = [
            share_removed(was, chance * left, floor)
            for was, left in map(of, power[draws])
            if is_reducible(was, floor)
        ]
        # The reference model leaves what it leaves, wherever.
        drawn = drawn if last != first else []
        low, high = np.quantile(drawn or [share], [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        interval = min(float(low), share), max(float(high), share)
        told = interval if len(groups) > 1 else None
        found[channel] = Gap(first, last, floor, share, told)
    return found
