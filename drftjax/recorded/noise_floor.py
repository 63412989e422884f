r"""Noise floor of residuals: the part that neither model nor sand can explain.

Two repeats, each simulated with its own zeta, have residuals r and r' (simulated minus recorded).
An effect of command, load or state is the same in both, and cancels in their difference; what is
left is chance. Each run contributes half of its power, so the noise floor is

$$ \sqrt{\tfrac12 \langle (r - r')^2 \rangle} , $$

averaged over the samples and over all pairs of repeats.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drftjax.recorded.observation import ROUNDING, sampling_intervals


@dataclass(frozen=True)
class NoiseFloorSettings:
    """Numbers of a noise floor.

    Attributes:
        max_partners: Other repeats that each repeat is compared with at most: hundreds of runs have
            too many pairs.
        min_samples: Samples of a run at least, where its white noise is estimated instead: three
            second differences.
    """

    max_partners: int = 10
    min_samples: int = 5


DEFAULT_NOISE_FLOOR = NoiseFloorSettings()


def is_recorded(time: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Mask of times at which a recording can be interpolated: inside it, and not in its gaps.

    Args:
        time: Of its samples [s], increasing, shape (samples,).
        wanted: Other times [s], shape (times,).

    Returns:
        Shape (times,).
    """
    inside = (wanted >= time[0] - ROUNDING) & (wanted <= time[-1] + ROUNDING)
    after = np.clip(np.searchsorted(time, wanted - ROUNDING), 0, len(time) - 1)
    at_sample = np.abs(time[after] - wanted) <= ROUNDING
    return inside & (at_sample | (sampling_intervals(time)[after] <= 1))


def interpolation_loss(time: np.ndarray, wanted: np.ndarray) -> float:
    r"""Share of white noise's power that linear interpolation averages away [-].

    Between two samples, at a share w of the interval, $w^2 + (1 - w)^2$ of it remains.

    Args:
        time: Of the samples [s], increasing, shape (samples,).
        wanted: Times that are interpolated [s], shape (times,).
    """
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    share = np.clip((wanted - time[after - 1]) / (time[after] - time[after - 1]), 0, 1)
    return 1 - float(np.mean(share**2 + (1 - share) ** 2))


def residual_difference(
    time: np.ndarray, residual: np.ndarray, other_time: np.ndarray, other_residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Difference of two runs' residuals at the first run's samples, where both have data.

    Args:
        time, other_time: Of their samples [s], shape (samples,) each.
        residual, other_residual: Shape (channels, samples) each.

    Returns:
        Mask of the first run's samples, and the difference there, shape (channels, samples kept).
    """
    both = is_recorded(other_time, time)
    interpolated = [np.interp(time[both], other_time, row) for row in other_residual]
    return both, residual[:, both] - interpolated


def repeat_power(difference: np.ndarray, lost_power: float = 0.0) -> float:
    r"""Power of chance in one of two repeats, $\tfrac12 (\langle d^2 \rangle + p)$.

    Args:
        difference: Of their residuals in one channel, shape (samples,).
        lost_power: Power of white noise that interpolation has averaged away, in the square of the
            channel's unit.
    """
    return (float(np.mean(difference**2)) + lost_power) / 2


def root_mean(powers: Iterable[float]) -> float:
    """Root of the mean of powers of equal weight."""
    return float(np.sqrt(np.mean([*powers])))
