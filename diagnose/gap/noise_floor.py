"""The noise floor: what repeated runs differ by, or else what instruments scatter by."""

from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.repeatability import Response, interpolation_loss, repeat_difference, repeats
from drftjax.recorded.observation import SMALLEST_NOISE, white_noise


def noise_floors(
    case: RigDataset,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    own: Mapping[str, float],
    response: Response,
) -> tuple[dict[str, float], str]:
    """Noise floor of each channel [m, N, N m], and a sentence on how it was found.

    Half the power of the difference between two repeats' residuals, each with its own zeta, is
    chance; the simulation's own error comes on top.

    Args:
        case: The runs.
        before, after: Residuals of each run by the reference model and by the best one, shape
            (channels, samples): the smaller difference counts, as an effect may differ in strength.
        own: The simulation's own error in each channel [m, N, N m], which no repeat shows, as both
            share it.
        response: Change of a run's channels by its log zeta; see
        `diagnose.gap.repeatability.repeat_difference`.
    """
    pairs = {each: repeats(case, each, from_one_start=False) for each in case.channels}
    floors: dict[str, float] = {}
    for index, channel in enumerate(case.channels):
        powers = [
            interpolation_loss(case, pair, channel) / 2
            + min(
                _power(repeat_difference(case, pair, each, response)[index])
                for each in (before, after)
            )
            for pair in pairs[channel]
        ]
        power = np.mean(powers) if powers else _noise_power(case, channel, (before, after))
        floors[channel] = float(np.sqrt(power + own[channel] ** 2))
    return floors, _in_words(case, pairs)


def _power(differ: np.ndarray) -> float:
    """Of each of two that differ by so much."""
    return float(np.mean(differ**2)) / 2


def _in_words(case: RigDataset, pairs: Mapping[str, Sequence[tuple[int, int]]]) -> str:
    """How floors were found, by the repeats of each channel."""
    if not any(pairs.values()):
        return (
            "No run was repeated: the noise floor is the instruments' fast scatter and what plates "
            "half as long would change, and says nothing of how runs scatter."
        )
    chains: list[list[int]] = []
    for first, second in sorted({pair for each in pairs.values() for pair in each}):
        chain = next((each for each in chains if first in each), None)
        if chain is None:
            chains.append([first, second])
        elif second not in chain:
            chain.append(second)
    names = "; ".join(" and ".join(case.runs[r].name for r in chain) for chain in chains)
    told = f"The noise floor is from repeats: {names}, and from what plates half as long would "
    lacking = [channel for channel, each in pairs.items() if not each]
    if not lacking:
        return f"{told}change."
    return f"{told}change; that of {', '.join(lacking)}, which no repeats have, from fast scatter."


def _noise_power(
    case: RigDataset, channel: str, residuals: Sequence[Sequence[np.ndarray]]
) -> float:
    """Mean square of the instrument's white noise, over the runs that have the channel.

    Read seldom, a wheel's own motion passes for noise in readings, and less in what a model leaves.
    """
    index = case.channels.index(channel)
    found = []
    for run, each in enumerate(case.runs):
        known = each.observation.by_channel()
        if channel in known:
            left = (white_noise(residual[run][index]) for residual in residuals)
            least = min(known[channel][1], *left)
            found.append(max(least, SMALLEST_NOISE[channel]) ** 2)
    return float(np.mean(found))
