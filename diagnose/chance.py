"""What repeats differ by beyond their noise: no effect of command, load or state makes that."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from diagnose.bench import Bench
from diagnose.blocks import KINDS, Splitter
from diagnose.case import Case
from diagnose.left_out import conditions
from identify.repeats import LEAST_SHARED, recorded_at

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
    found = [
        power
        for index, channel in enumerate(bench.case.channels)
        for power in _of_channel(bench.case, index, repeats(bench.case, channel), residuals)
    ]
    return np.array(found)


def repeats(case: Case, channel: str, from_one_start: bool = True) -> list[tuple[int, int]]:
    """Runs that have a channel and repeat each other, by number: each with the next of its kind.

    Args:
        case: The runs.
        channel: The channel.
        from_one_start: Whether they must begin at the same place and wheel angle too.
    """
    kinds: list[list[int]] = []
    for condition in conditions(case.candidates):
        of_condition: list[list[int]] = []
        for run in condition:
            if channel not in case.candidates[run].observation.channels:
                continue
            for kind in of_condition:
                begin = not from_one_start or _begin_alike(case, kind[0], run)
                if begin and _recorded_alike(case, kind[0], run):
                    kind.append(run)
                    break
            else:
                of_condition.append([run])
        kinds += of_condition
    return [pair for kind in kinds for pair in pairwise(kind)]


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


def _begin_alike(case: Case, one: int, other: int) -> bool:
    a, b = (case.candidates[run].setup.start for run in (one, other))
    turned = np.angle(np.exp(1j * (a.angle - b.angle)))
    return abs(a.x - b.x) <= SAME_PLACE and bool(abs(turned) <= SAME_ANGLE)


def _recorded_alike(case: Case, one: int, other: int) -> bool:
    time, there = case.time(one), case.time(other)
    shared = (recorded_at(there, time).mean(), recorded_at(time, there).mean())
    return bool(min(shared) >= LEAST_SHARED)


def _of_channel(
    case: Case,
    index: int,
    pairs: Sequence[tuple[int, int]],
    residuals: Sequence[list[np.ndarray]],
) -> list[float]:
    """Half the mean square of the difference in each of a channel's blocks, by the best model."""
    if not pairs:
        return [0.0] * len(KINDS)
    by_model = [
        np.mean([_by_block(case, index, pair, residual) for pair in pairs], axis=0)
        for residual in residuals
    ]
    return np.min(by_model, axis=0).tolist()


def _by_block(
    case: Case, index: int, pair: tuple[int, int], residual: Sequence[np.ndarray]
) -> list[float]:
    time = case.time(pair[0])
    splitter = Splitter.of(time[recorded_at(case.time(pair[1]), time)])
    differ = apart(case, pair, residual)[index]
    parts = splitter.split(case.channels[index], differ[:, None]).values()
    return [float(np.mean(part**2)) / 2 if part.size else 0.0 for part in parts]
