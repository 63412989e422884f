"""Repeats: runs of the same command and set-up, and what they say of chance."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from identify.result import RunFit


def repeated(runs: Sequence[RunFit]) -> list[list[int]]:
    """Groups of two or more runs with the same command, set-up and recorded times, by index."""
    groups: list[list[int]] = []
    for index, run in enumerate(runs):
        for group in groups:
            if _same(run, runs[group[0]]):
                group.append(index)
                break
        else:
            groups.append([index])
    return [group for group in groups if len(group) > 1]


def _same(run: RunFit, other: RunFit) -> bool:
    ours, theirs = run.setup.command, other.setup.command
    return (
        run.channels == other.channels
        and np.array_equal(run.time, other.time)
        and (ours.time, ours.omega, ours.vx) == (theirs.time, theirs.omega, theirs.vx)
        and run.setup.wheel == other.setup.wheel
        and (run.setup.rig.mass_x, run.setup.rig.mass_z)
        == (other.setup.rig.mass_x, other.setup.rig.mass_z)
    )


def noise_floor(runs: Sequence[RunFit]) -> dict[str, float]:
    """What two repeats differ by beyond their own fitted values, per run and channel [m, N, N m].

    Half the power of the difference of two runs' residuals is what neither model nor sand, the
    same for both, can account for. Empty where no run was repeated.
    """
    powers: dict[str, list[float]] = {}
    for group in repeated(runs):
        for first, second in pairwise(group):
            a, b = runs[first], runs[second]
            both = a.counts & b.counts
            apart = (a.after - a.recorded) - (b.after - b.recorded)
            for channel, difference in zip(a.channels, apart, strict=True):
                powers.setdefault(channel, []).append(float(np.mean(difference[both] ** 2)) / 2)
    return {channel: float(np.sqrt(np.mean(each))) for channel, each in powers.items()}
