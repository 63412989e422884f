"""What repeats differ by beyond their noise: no effect of command, load or state makes that."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from diagnose.bench import Bench
from diagnose.blocks import KINDS, Splitter
from diagnose.case import Case
from diagnose.left_out import conditions
from identify.repeats import recorded_at

# Repeats begin at the same place [m] and wheel angle [rad] within this; where an effect lies along
# the bed or goes with the wheel's angle, others differ by it.
SAME_PLACE, SAME_ANGLE = 5e-3, np.deg2rad(1.0)


def chance(bench: Bench, residuals: Sequence[list[np.ndarray]]) -> np.ndarray:
    """Mean square, in each block, of what repeats differ by: half that of their difference.

    Every run has its own zeta. Of several models the one counts by which repeats differ least, as
    an effect may bear differently on sands that differ.

    Args:
        bench: The case.
        residuals: By model and run, simulated less recorded, shape (channels, samples).

    Returns:
        Shape (blocks,), in the blocks' units squared; zero where no run was repeated.
    """
    case = bench.case
    number = len(bench.products.blocks)
    least = np.full(number, np.inf)
    for residual in residuals:
        pairs = [_by_block(case, pair, residual) for pair in repeats(case)]
        told = np.array(pairs).reshape(-1, number)
        known = np.isfinite(told)
        power = np.where(known, told, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        least = np.minimum(least, power)
    return np.where(np.isfinite(least), least, 0.0)


def repeats(case: Case) -> list[tuple[int, int]]:
    """Neighbours among the runs of one condition that begin alike, by number."""
    starts = [each.setup.start for each in case.candidates]

    def alike(one: int, other: int) -> bool:
        a, b = starts[one], starts[other]
        turned = np.angle(np.exp(1j * (a.angle - b.angle)))
        return abs(a.x - b.x) <= SAME_PLACE and abs(turned) <= SAME_ANGLE

    return [
        pair for group in conditions(case.candidates) for pair in pairwise(group) if alike(*pair)
    ]


def apart(case: Case, pair: tuple[int, int], residual: Sequence[np.ndarray]) -> np.ndarray:
    """What the residuals of two runs differ by, where both were recorded.

    Args:
        case: The runs.
        pair: Two of them, by number.
        residual: By run, shape (channels, samples).

    Returns:
        At the first one's samples, shape (channels, times).
    """
    one, other = pair
    time, there = case.time(one), case.time(other)
    both = recorded_at(there, time)
    at_same_times = [np.interp(time[both], there, row) for row in residual[other]]
    return residual[one][:, both] - at_same_times


def _by_block(case: Case, pair: tuple[int, int], residual: Sequence[np.ndarray]) -> list[float]:
    """Half the mean square of the difference, block by block; NaN where one lacks the channel."""
    differ = apart(case, pair, residual)
    if not differ.size:
        return [np.nan] * (len(KINDS) * len(case.channels))
    time = case.time(pair[0])
    splitter = Splitter.of(time[recorded_at(case.time(pair[1]), time)])
    blocks = [
        part
        for channel, row in zip(case.channels, differ, strict=True)
        for part in splitter.split(channel, row[:, None]).values()
    ]
    return [float(np.mean(part**2)) / 2 if part.size else np.nan for part in blocks]
