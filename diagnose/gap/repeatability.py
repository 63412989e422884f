"""What repeats differ by beyond their noise: no effect of command, load or state makes that."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.linear.residual_blocks import KINDS, SlowFastSplit
from drftjax.recorded.repeats import (
    LEAST_SHARED,
    group_by_condition,
    interpolate_recorded,
    noise_after_interpolation,
)

# Repeats begin at the same place [m] and wheel angle [rad] within this; where an effect lies along
# the bed or goes with the wheel's angle, others differ by it.
SAME_PLACE, SAME_ANGLE = 5e-3, np.deg2rad(1.0)


# Change of a run's channels by its log zeta, by its number; shape (channels, samples).
Response = Callable[[int], np.ndarray]


def repeat_variance(
    case: RigDataset, residuals: Sequence[list[np.ndarray]], response: Response
) -> np.ndarray:
    """Mean square, in each block, of what repeats differ by: half that of their difference.

    Every run has its own zeta. Of several models the one counts by which repeats differ least, as
    an effect may bear differently on sands that differ.

    Args:
        case: The runs.
        residuals: By model and run, simulated less recorded, shape (channels, samples).
        response: See `apart`.

    Returns:
        Shape (blocks,), in the blocks' units squared; zero where no run was repeated.
    """
    found = [
        power
        for index, channel in enumerate(case.channels)
        for power in _of_channel(case, index, repeats(case, channel), residuals, response)
    ]
    return np.array(found)


def repeats(case: RigDataset, channel: str, from_one_start: bool = True) -> list[tuple[int, int]]:
    """Runs that have a channel and repeat each other, by number: all pairs of a kind.

    Args:
        case: The runs.
        channel: The channel.
        from_one_start: Whether they must begin at the same place and wheel angle too.
    """
    kinds: list[list[int]] = []
    for condition in group_by_condition(case.runs):
        of_condition: list[list[int]] = []
        for run in condition:
            if channel not in case.runs[run].observation.channels:
                continue
            for kind in of_condition:
                begin = not from_one_start or _begin_alike(case, kind[0], run)
                if begin and min(_shared(case, (kind[0], run))) >= LEAST_SHARED:
                    kind.append(run)
                    break
            else:
                of_condition.append([run])
        kinds += of_condition
    return [pair for kind in kinds for pair in combinations(kind, 2)]


def repeat_difference(
    case: RigDataset, pair: tuple[int, int], residual: Sequence[np.ndarray], response: Response
) -> np.ndarray:
    """What the residuals of two runs differ by, where both were recorded.

    Where one was recorded over less time, the zeta that suits it meets another part of the run, and
    a misfit that grows in both would differ between them: the first one's zeta is then moved along
    a straight line until both miss the same mean sinkage over the time that they share.

    Args:
        case: The runs.
        pair: Two of them, by number.
        residual: By run, shape (channels, samples).
        response: Change of a run's channels by its log zeta.

    Returns:
        At the first one's samples, shape (channels, times).
    """
    one, other = pair
    time, there = case.time(one), case.time(other)
    both = interpolate_recorded(there, time)
    at_same_times = [np.interp(time[both], there, row) for row in residual[other]]
    differ = residual[one][:, both] - at_same_times
    if min(_shared(case, pair)) == 1:
        return differ
    z, by_zeta = case.channels.index("z"), response(one)[:, both]
    slope = by_zeta[z].mean()
    return differ - differ[z].mean() / slope * by_zeta if slope > 0 else differ


def interpolation_loss(case: RigDataset, pair: tuple[int, int], channel: str) -> float:
    """Power of the second run's white noise that `apart` loses where it reads between samples.

    Nothing where both clocks agree [m, N, N m, squared].
    """
    one, other = pair
    time, there = case.time(one), case.time(other)
    lost = 1 - noise_after_interpolation(there, time[interpolate_recorded(there, time)])
    _, noise = case.runs[other].observation.by_channel()[channel]
    return lost * float(noise) ** 2


def _begin_alike(case: RigDataset, one: int, other: int) -> bool:
    a, b = (case.runs[run].setup.start for run in (one, other))
    turned = np.angle(np.exp(1j * (a.angle - b.angle)))
    return abs(a.x - b.x) <= SAME_PLACE and bool(abs(turned) <= SAME_ANGLE)


def _shared(case: RigDataset, pair: tuple[int, int]) -> tuple[float, float]:
    """Share of each run's samples at which the other was recorded too."""
    one, other = (case.time(run) for run in pair)
    return float(interpolate_recorded(other, one).mean()), float(
        interpolate_recorded(one, other).mean()
    )


def _of_channel(
    case: RigDataset,
    index: int,
    pairs: Sequence[tuple[int, int]],
    residuals: Sequence[list[np.ndarray]],
    response: Response,
) -> list[float]:
    """Half the mean square of the difference in each of a channel's blocks, by the best model."""
    if not pairs:
        return [0.0] * len(KINDS)
    by_model = [
        np.mean([_by_block(case, index, p, residual, response) for p in pairs], axis=0)
        for residual in residuals
    ]
    return np.min(by_model, axis=0).tolist()


def _by_block(
    case: RigDataset,
    index: int,
    pair: tuple[int, int],
    residual: Sequence[np.ndarray],
    response: Response,
) -> list[float]:
    time = case.time(pair[0])
    splitter = SlowFastSplit.of(time[interpolate_recorded(case.time(pair[1]), time)])
    differ = repeat_difference(case, pair, residual, response)[index]
    parts = splitter.split(case.channels[index], differ[:, None]).values()
    return [float(np.mean(part**2)) / 2 if part.size else 0.0 for part in parts]
