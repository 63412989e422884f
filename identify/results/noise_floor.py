"""Noise floor of a fit: the difference of repeats, or else the white noise of its residuals."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from drftjax.recorded.noise_floor import (
    DEFAULT_NOISE_FLOOR,
    NoiseFloorSettings,
    interpolation_loss,
    repeat_power,
    residual_difference,
    root_mean,
)
from drftjax.recorded.observation import white_noise
from drftjax.recorded.repeats import (
    DEFAULT_TOLERANCES,
    RepeatTolerances,
    RunCondition,
    group_conditions,
)
from identify.results.values import RunFit


def repeated_runs(
    runs: Sequence[RunFit], tolerances: RepeatTolerances = DEFAULT_TOLERANCES
) -> list[list[int]]:
    """Groups of two or more runs of one condition, by index.

    Wheel and rig count as they were believed to be before the fit. The sand before the fit is not
    kept, and the fitted one is no part of the condition.
    """

    def condition(run: RunFit) -> RunCondition:
        wheel, rig = run.believed or (run.setup.wheel, run.setup.rig)
        return RunCondition(run.setup.command.build(), wheel, rig)

    groups = group_conditions([condition(each) for each in runs], tolerances)
    return [group for group in groups if len(group) > 1]


def noise_floor(
    runs: Sequence[RunFit],
    tolerances: RepeatTolerances = DEFAULT_TOLERANCES,
    settings: NoiseFloorSettings = DEFAULT_NOISE_FLOOR,
) -> dict[str, float]:
    """Difference of two repeats beyond their own fitted values, per run and channel [m, N, N m].

    See `drftjax.recorded.noise_floor`. White noise that is lost where one run is interpolated, as
    clocks differ, is added again.

    Args:
        runs: Fitted runs.
        tolerances: Differences that repeats may have.
        settings: Numbers of a noise floor.

    Returns:
        By channel; empty where no run was repeated.
    """
    powers: dict[str, list[float]] = {}
    for group in repeated_runs(runs, tolerances):
        for first, second in _pairs(group, settings.max_partners):
            for channel, power in _pair_powers(runs[first], runs[second], tolerances).items():
                powers.setdefault(channel, []).append(power)
    return {channel: root_mean(each) for channel, each in powers.items()}


def _pair_powers(a: RunFit, b: RunFit, tolerances: RepeatTolerances) -> dict[str, float]:
    """Power of chance by channel, of two repeats; empty where they cannot be compared."""
    # Fits of other channels met other readings, and a copy of a run repeats nothing.
    copied = np.ptp(a.recorded) > 0 and np.array_equal(a.recorded, b.recorded)
    if a.channels != b.channels or copied:
        return {}
    (time, left), (other_time, other_left) = (
        (each.time[each.counts], (each.after - each.recorded)[:, each.counts]) for each in (a, b)
    )
    both, differences = residual_difference(time, left, other_time, other_left)
    if both.sum() < tolerances.shared_by_fits * max(len(time), len(other_time)):
        return {}
    loss = interpolation_loss(other_time, time[both])
    return {
        channel: repeat_power(difference, loss * white_noise(other) ** 2)
        for channel, difference, other in zip(a.channels, differences, other_left, strict=True)
    }


def _pairs(group: Sequence[int], max_partners: int) -> Iterator[tuple[int, int]]:
    """Every two of a group once; of a large one, each run with as many others as the next one."""
    size = len(group)
    for distance in range(1, min(max_partners, size // 2) + 1):
        # Half way round a circle, each two meet twice.
        for place in range(size // 2 if 2 * distance == size else size):
            yield group[place], group[(place + distance) % size]


def reading_noise(
    recorded: Float[np.ndarray, " samples"], residual: Float[np.ndarray, " samples"]
) -> float:
    """White noise of a residual, in its unit, and no less than the readings' step allows.

    A sensor that is slower than its logger repeats readings; of these only the first counts.

    Args:
        recorded: Readings.
        residual: Simulated minus recorded.
    """
    fresh = np.r_[True, np.diff(recorded) != 0]
    # Readings rounded to a step are off by up to half of it, evenly.
    return max(white_noise(residual[fresh]), reading_step(recorded) / np.sqrt(12))


def reading_step(recorded: Float[np.ndarray, " samples"]) -> float:
    """Step that readings are rounded to, in their unit; hardly any where they are not.

    Rounded readings, and how much faster these become, are multiples of it. The second keeps an
    even motion from passing for a step.

    Args:
        recorded: Readings.
    """
    rounding = 1e-9 * float(np.ptp(recorded)) if len(recorded) else 0.0
    fresh = recorded[np.diff(recorded, prepend=np.nan) != 0]
    uneven = np.abs(np.diff(fresh, 2))
    apart = np.r_[np.diff(np.unique(recorded)), uneven]
    return float(apart[apart > rounding].min()) if (uneven > rounding).any() else 0.0


def fast_scatter(
    runs: Sequence[RunFit], settings: NoiseFloorSettings = DEFAULT_NOISE_FLOOR
) -> dict[str, float]:
    """White noise of the residuals, by channel [m, N, N m]; root mean square over the runs.

    Runs of too few samples to estimate it are left out.
    """
    powers: dict[str, list[float]] = {}
    for run in runs:
        if run.counts.sum() < settings.min_samples:
            continue
        for channel, recorded, residual in zip(
            run.channels, run.recorded, run.after - run.recorded, strict=True
        ):
            noise = reading_noise(recorded[run.counts], residual[run.counts])
            powers.setdefault(channel, []).append(noise**2)
    return {channel: root_mean(each) for channel, each in powers.items()}
