"""Variance between repeats, which no effect of command, load or state explains."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.linear.residual_blocks import SlowFastSplit, kinds_of
from drftjax.recorded.noise_floor import (
    interpolation_loss,
    is_recorded,
    repeat_power,
    residual_difference,
)
from drftjax.recorded.repeats import DEFAULT_TOLERANCES, RepeatTolerances, group_by_condition

ZetaResponse = Callable[[int], np.ndarray]
"""Derivative of a run's channels by its log zeta [m, N, N m], by the run's index; shape (channels,
samples)."""


def repeat_variance(
    dataset: RigDataset,
    residuals: Sequence[list[np.ndarray]],
    response: ZetaResponse,
    tolerances: RepeatTolerances = DEFAULT_TOLERANCES,
) -> np.ndarray:
    r"""Variance of chance in each block, $\tfrac12 \langle (r - r')^2 \rangle$ over all repeats.

    Every run has its own zeta. Of several models the one counts by which repeats differ least, as
    an effect may differ in strength on sands that differ.

    Args:
        dataset: The runs.
        residuals: By model and run, simulated minus recorded, shape (channels, samples).
        response: Needed where one of two repeats was recorded over less time.
        tolerances: Differences that repeats may have.

    Returns:
        Shape (blocks,), in the blocks' units squared; zero where no run was repeated.
    """
    found = [
        power
        for index, channel in enumerate(dataset.channels)
        for power in _channel_variance(
            dataset, index, repeats(dataset, channel, tolerances=tolerances), residuals, response
        )
    ]
    return np.array(found)


def repeats(
    dataset: RigDataset,
    channel: str,
    from_one_start: bool = True,
    tolerances: RepeatTolerances = DEFAULT_TOLERANCES,
) -> list[tuple[int, int]]:
    """All pairs of runs that have a channel and repeat each other, by index.

    Args:
        dataset: The runs.
        channel: Name of the channel.
        from_one_start: True where they must begin at the same place and wheel angle too.
        tolerances: Differences that repeats may have.
    """
    groups: list[list[int]] = []
    for condition in group_by_condition(dataset.runs, tolerances):
        of_condition: list[list[int]] = []
        for run in condition:
            if not _is_compared(dataset, run, channel):
                continue
            for group in of_condition:
                starts = not from_one_start or _equal_starts(dataset, group[0], run, tolerances)
                if starts and min(_shared(dataset, (group[0], run))) >= tolerances.shared:
                    group.append(run)
                    break
            else:
                of_condition.append([run])
        groups += of_condition
    return [pair for group in groups for pair in combinations(group, 2)]


def repeat_difference(
    dataset: RigDataset,
    pair: tuple[int, int],
    residual: Sequence[np.ndarray],
    response: ZetaResponse,
) -> np.ndarray:
    r"""Difference of the residuals of two repeats at the first one's samples, where both have data.

    Each run has the zeta that matches its mean sinkage. Where one was recorded over less time,
    these means are over different parts of the run, and a residual that grows in both would differ
    between them. The first run's zeta is then changed until both miss the same mean sinkage over
    the time that they share, $d - (\bar d_z / \bar s_z)\, s$ with its linear response s.

    Args:
        dataset: The runs.
        pair: Two of them, by index.
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
        response: Derivative of a run's channels by its log zeta.

    Returns:
        Shape (channels, samples of the first run that are kept).
    """
    one, other = pair
    both, differences = residual_difference(
        dataset.time(one), residual[one], dataset.time(other), residual[other]
    )
    if min(_shared(dataset, pair)) == 1:
        return differences
    z, by_zeta = dataset.channels.index("z"), response(one)[:, both]
    slope = by_zeta[z].mean()
    return differences - differences[z].mean() / slope * by_zeta if slope > 0 else differences


def lost_noise_power(dataset: RigDataset, pair: tuple[int, int], channel: str) -> float:
    """Power of the second run's white noise that `repeat_difference` averages away [unit squared].

    Zero where both clocks agree.
    """
    one, other = pair
    time, other_time = dataset.time(one), dataset.time(other)
    loss = interpolation_loss(other_time, time[is_recorded(other_time, time)])
    _, noise = dataset.runs[other].observation.by_channel()[channel]
    return loss * float(noise) ** 2


def _is_compared(dataset: RigDataset, run: int, channel: str) -> bool:
    """Tell whether a run has a channel; of a very short one no force is compared."""
    recording = dataset.recording(run)[dataset.channels.index(channel)]
    return bool(np.isfinite(recording).all())


def _equal_starts(dataset: RigDataset, one: int, other: int, tolerances: RepeatTolerances) -> bool:
    a, b = (dataset.runs[run].setup.start for run in (one, other))
    turned = np.angle(np.exp(1j * (a.angle - b.angle)))
    return abs(a.x - b.x) <= tolerances.position and bool(abs(turned) <= tolerances.angle)


def _shared(dataset: RigDataset, pair: tuple[int, int]) -> tuple[float, float]:
    """Share of each run's samples at which the other was recorded too [-]."""
    one, other = (dataset.time(run) for run in pair)
    return float(is_recorded(other, one).mean()), float(is_recorded(one, other).mean())


def _channel_variance(
    dataset: RigDataset,
    index: int,
    pairs: Sequence[tuple[int, int]],
    residuals: Sequence[list[np.ndarray]],
    response: ZetaResponse,
) -> list[float]:
    """Variance of chance in each of a channel's blocks, by the model that leaves least of it."""
    if not pairs:
        return [0.0] * len(kinds_of(dataset.channels[index]))
    by_model = [
        np.mean([_block_powers(dataset, index, p, residual, response) for p in pairs], axis=0)
        for residual in residuals
    ]
    return np.min(by_model, axis=0).tolist()


def _block_powers(
    dataset: RigDataset,
    index: int,
    pair: tuple[int, int],
    residual: Sequence[np.ndarray],
    response: ZetaResponse,
) -> list[float]:
    """Power of chance in each of a channel's blocks, of one pair of repeats."""
    time = dataset.time(pair[0])
    time = time[is_recorded(dataset.time(pair[1]), time)]
    splitter = SlowFastSplit.of(time, dataset.runs[pair[0]].observation.mean_speed)
    difference = repeat_difference(dataset, pair, residual, response)[index]
    parts = splitter.split(dataset.channels[index], difference[:, None]).values()
    return [repeat_power(part) if part.size else 0.0 for part in parts]
