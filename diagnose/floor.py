"""The noise floor: what repeated runs differ by, or else what instruments scatter by."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from diagnose.case import Case
from diagnose.chance import apart
from diagnose.left_out import conditions


def noise_floors(
    case: Case,
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    own: Mapping[str, float],
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
    """
    powers: dict[str, list[float]] = {}
    repeats = [group for group in conditions(case.candidates) if len(group) > 1]
    for group in repeats:
        for first, second in pairwise(group):
            for index, channel in enumerate(case.channels):
                differ = [apart(case, (first, second), each)[index] for each in (before, after)]
                # Nothing where they were never recorded at once, or one of the two lacks it.
                if differ[0].size and np.isfinite(differ).all():
                    power = min(float(np.mean(each**2)) / 2 for each in differ)
                    powers.setdefault(channel, []).append(power)
    floors = {}
    for channel in case.channels:
        power = np.mean(powers[channel]) if powers.get(channel) else _noise_power(case, channel)
        floors[channel] = float(np.sqrt(power + own[channel] ** 2))
    names = [[case.candidates[r].name for r in group] for group in repeats]
    if names:
        how = (
            "The noise floor is from repeats: "
            + "; ".join(" and ".join(n) for n in names)
            + ", and from what plates half as long would change."
        )
    else:
        how = (
            "No run was repeated: the noise floor is the instruments' fast scatter and what plates "
            "half as long would change, and says nothing of how runs scatter."
        )
    return floors, how


def _noise_power(case: Case, channel: str) -> float:
    """Mean square of the instrument's white noise, over the runs that have the channel."""
    known = [each.observation.by_channel() for each in case.candidates]
    return float(np.mean([each[channel][1] ** 2 for each in known if channel in each]))
