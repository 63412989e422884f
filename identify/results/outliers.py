"""Outliers, and runs that begin in motion: recordings that bias a fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter

from drftjax.recorded.commanded_motion import DEFAULT_MOTION, commanded_speed
from drftjax.recorded.observation import white_noise
from identify.results.values import RunFit


@dataclass(frozen=True)
class OutlierSettings:
    """Numbers of the search for outliers.

    Attributes:
        noises: Distance of an outlier from the running median, in standard deviations of the noise.
            Of white noise none in a million lies so far; at a step, as where a wheel sets off, the
            median is one side of it.
        window: Readings of the running median.
        smallest_noise: Smallest noise by channel [m, N, N m]: a simulation's own scatter is no
            reading's fault.
    """

    noises: float = 20.0
    window: int = 5
    smallest_noise: Mapping[str, float] = field(
        default_factory=lambda: {"x": 2e-5, "z": 2e-5, "fx": 1.0, "fz": 1.0, "torque": 0.1}
    )


OUTLIER_SETTINGS = OutlierSettings()


def outlier_times(
    run: RunFit, settings: OutlierSettings = OUTLIER_SETTINGS
) -> dict[str, np.ndarray]:
    """Return the times of outliers [s], by channel; only channels with some.

    Args:
        run: Fitted: its residuals are judged, which are smoother than the readings.
        settings: Decision numbers.
    """
    found = {}
    for channel, residual in run.residuals.items():
        values, time = residual[run.counts], run.time[run.counts]
        if len(values) < settings.window:
            continue
        noise = max(white_noise(values), settings.smallest_noise[channel])
        out = np.abs(values - median_filter(values, settings.window)) > settings.noises * noise
        if out.any():
            found[channel] = time[out]
    return found


def outlier_sentences(
    runs: Sequence[RunFit], settings: OutlierSettings = OUTLIER_SETTINGS
) -> list[str]:
    """Return sentences on runs whose readings hold outliers."""
    sentences = []
    for run in runs:
        for channel, times in outlier_times(run, settings).items():
            number = f"{len(times)} readings" if len(times) > 1 else "one reading"
            stand, first = ("stand", ", the first") if len(times) > 1 else ("stands", "")
            sentences.append(
                f"{run.name}: {number} of {channel} {stand} out by over {settings.noises:g} times "
                f"the noise{first} at {times[0]:.4g} s; all channels are weighed by what is left, "
                "so take such readings out"
            )
    return sentences


def moving_start_sentences(runs: Sequence[RunFit]) -> list[str]:
    """Return sentences on runs that begin in motion, simulated from a carriage at rest."""
    names = []
    for run in runs:
        setup, fitted = run.setup, {each.split(".", 1)[-1] for each in run.values}
        command = setup.command.build()
        rim = commanded_speed(setup.wheel.radius, command.omega)
        free = setup.rig.carriage == "free"
        if (
            free
            and rim[0] > DEFAULT_MOTION.standing_share * rim.max()
            and not setup.start.speed
            and "speed" not in fitted
        ):
            names.append(run.name)
    if not names:
        return []
    begin = "begins" if len(names) == 1 else "begin"
    return [
        f"{', '.join(names)} {begin} in motion, simulated from a carriage at rest: fit its speed "
        "too (--own start.speed)"
    ]
