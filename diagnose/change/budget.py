r"""Budget of the difference between before and now, by channel.

The mean square of the difference (mean of now less mean of before, over conditions and samples) is
that of noise, of what is left, of the change, and of zeta's scatter from run to run. The last two
act together: with $P(\theta, \zeta)$ the mean square that is left with the change and with the
scatter, each is given the mean of what it takes off first and last (Shapley 1953),

$$\tfrac12 [P(0, 0) - P(\theta, 0) + P(0, \zeta) - P(\theta, \zeta)],$$

so that the parts add up. A part below zero makes the difference larger where it acts alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.change.differences.gram import Differences, SharedClock
from diagnose.change.hypothesis import ChangeHypothesis, ChangeProblem


@dataclass(frozen=True)
class DifferenceBudget:
    """Parts of one channel's difference.

    Attributes:
        channel: Its name.
        rms: Root mean square of the difference at one zeta for both [m, N, N m].
        change: Share of its square that the change explains [-]; zero where nothing changed.
        zeta_scatter: Share by zeta's scatter from run to run [-].
        remainder: Share that nothing explains [-].
        noise: Share of the instruments' white noise [-]; the four shares sum to one.
    """

    channel: str
    rms: float
    change: float
    zeta_scatter: float
    remainder: float
    noise: float


def difference_budget(problem: ChangeProblem, chosen: ChangeHypothesis) -> list[DifferenceBudget]:
    """Budget of the difference, one entry for each channel.

    Args:
        problem: The runs.
        chosen: The explanation.
    """
    differences = problem.differences
    deviation = differences.centring @ problem.deviation(chosen)
    without, left = problem.residual_without(None), problem.residual_by_law(chosen)
    by_channel = problem.law_factors(chosen)
    factors = np.array([[by_channel[each]] for each in differences.dataset.channels])
    scatter = zip(left, chosen.by_zeta, deviation, strict=True)
    steady = [r - factors * z * d for r, z, d in scatter]
    scatter = zip(without, problem.by_zeta, deviation, strict=True)
    scattered = [r + factors * z * d for r, z, d in scatter]
    if not len(chosen.coordinates):
        # No change acts: all is zeta's scatter, what is left, and noise.
        steady, scattered = without, left
    powers = [_powers(differences, each) for each in (without, steady, scattered, left)]
    found = []
    for place, channel in enumerate(differences.dataset.channels):
        nothing, by_change, by_zeta, both = (float(each[place]) for each in powers)
        if not nothing > 0:
            continue
        noise = min(_noise_power(differences, channel), both)
        found.append(
            DifferenceBudget(
                channel,
                float(np.sqrt(nothing)),
                (nothing - by_change + by_zeta - both) / 2 / nothing,
                (nothing - by_zeta + by_change - both) / 2 / nothing,
                (both - noise) / nothing,
                noise / nothing,
            )
        )
    return found


def _powers(differences: Differences, residual: Sequence[np.ndarray]) -> np.ndarray:
    """Mean square of the difference of each channel, shape (channels,)."""
    parts = [
        mean_of(differences, clock, clock.condition.now, residual)
        - mean_of(differences, clock, clock.condition.before, residual)
        for clock in differences.clocks
    ]
    return np.nanmean(np.concatenate(parts, axis=1) ** 2, axis=1)


def mean_of(
    differences: Differences,
    clock: SharedClock,
    runs: Sequence[int],
    values: Sequence[np.ndarray],
) -> np.ndarray:
    """Mean over some runs of a condition at its clock, shape (channels, samples)."""
    time = differences.dataset.time
    return np.mean([clock.at(time(run), values[run].T).T for run in runs], axis=0)


def _noise_power(differences: Differences, channel: str) -> float:
    """Mean square of the white noise of a difference of means."""
    found, dataset = [], differences.dataset
    for clock in differences.clocks:
        power = 0.0
        for side in (clock.condition.before, clock.condition.now):
            seen = {run: dataset.runs[run].observation.by_channel() for run in side}
            noise = [
                dataset.holds[run].noise(channel, float(each[channel][1]))
                for run, each in seen.items()
                if channel in each
            ]
            power += sum(each**2 for each in noise) / max(len(side), 1) ** 2
        found += [power] * len(clock.time)
    return float(np.mean(found))
