"""Noise floor of a diagnosis: the difference of repeats, or else the white noise of instruments."""

from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.repeatability import ZetaResponse, lost_noise_power, repeat_difference, repeats
from drftjax.recorded.noise_floor import repeat_power, root_mean
from drftjax.recorded.observation import SMALLEST_NOISE, white_noise
from drftjax.recorded.repeats import DEFAULT_TOLERANCES, RepeatTolerances


def noise_floors(
    dataset: RigDataset,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    own: Mapping[str, float],
    response: ZetaResponse,
    tolerances: RepeatTolerances = DEFAULT_TOLERANCES,
) -> tuple[dict[str, float], str]:
    r"""Noise floor of each channel, and a sentence on how it was found.

    $\sqrt{\tfrac12 \langle (r - r')^2 \rangle + e^2}$ over all pairs of repeats, each with its own
    zeta, with the discretisation error e, which no repeat shows, as both share it. See
    `drftjax.recorded.noise_floor`.

    Args:
        dataset: The runs.
        before, after: Residuals of each run by the reference model and by the best one, shape
            (channels, samples): the smaller difference counts, as an effect may differ in strength.
        own: Discretisation error of the simulation in each channel [m, N, N m].
        response: Derivative of a run's channels by its log zeta; see
            `diagnose.gap.repeatability.repeat_difference`.
        tolerances: Differences that repeats may have.

    Returns:
        Floors by channel [m, N, N m], and the sentence.
    """
    pairs = {
        channel: repeats(dataset, channel, from_one_start=False, tolerances=tolerances)
        for channel in dataset.channels
    }
    floors: dict[str, float] = {}
    for index, channel in enumerate(dataset.channels):
        powers = [
            min(
                repeat_power(
                    repeat_difference(dataset, pair, residual, response)[index],
                    lost_noise_power(dataset, pair, channel),
                )
                for residual in (before, after)
            )
            for pair in pairs[channel]
        ]
        chance = root_mean(powers or _noise_powers(dataset, channel, (before, after)))
        floors[channel] = float(np.hypot(chance, own[channel]))
    return floors, _sentence(dataset, pairs)


def _sentence(dataset: RigDataset, pairs: Mapping[str, Sequence[tuple[int, int]]]) -> str:
    """Source of the floors, by the repeats of each channel."""
    if not any(pairs.values()):
        return (
            "No run was repeated: the noise floor is the instruments' fast scatter and the "
            "discretisation check's change, and says nothing of how runs scatter."
        )
    chains: list[list[int]] = []
    for first, second in sorted({pair for each in pairs.values() for pair in each}):
        chain = next((each for each in chains if first in each), None)
        if chain is None:
            chains.append([first, second])
        elif second not in chain:
            chain.append(second)
    names = "; ".join(" and ".join(dataset.runs[r].name for r in chain) for chain in chains)
    source = f"The noise floor is from repeats: {names}, and from what finer plates would "
    lacking = [channel for channel, each in pairs.items() if not each]
    if not lacking:
        return f"{source}change."
    return (
        f"{source}change; that of {', '.join(lacking)}, which no repeats have, from fast scatter."
    )


def _noise_powers(
    dataset: RigDataset, channel: str, residuals: Sequence[Sequence[np.ndarray]]
) -> list[float]:
    """Power of the instrument's white noise in each run that has the channel.

    With few samples a second the wheel's own motion is counted as noise of the readings, and less
    of it as noise of the residuals: the smallest estimate counts. What holds a free carriage is an
    average, which scatters by less than its readings, and not from sample to sample.
    """
    index = dataset.channels.index(channel)
    powers = []
    for run, each in enumerate(dataset.runs):
        known = each.observation.by_channel()
        if channel in known:
            hold, sigma = dataset.holds[run], float(known[channel][1])
            if channel in hold.masses:
                noise = hold.noise(channel, sigma)
            else:
                noise = min(sigma, *(white_noise(each[run][index]) for each in residuals))
            powers.append(max(noise, SMALLEST_NOISE[channel]) ** 2)
    return powers
