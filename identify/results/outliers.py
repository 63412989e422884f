"""Readings that stand out, and runs that begin in motion: what a fit follows and should not."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from drftjax.recorded.commanded_motion import DEFAULT_MOTION, commanded_speed
from drftjax.recorded.observation import white_noise
from identify.results.values import RunFit

# A reading stands out that lies so many times the noise from the median of so many around it. Of
# white noise none in a million does; of a step, as where a wheel sets off, the median is one side.
STANDS_OUT, AROUND = 20.0, 5


# Noise is taken for this at least [m, N, N m]: what a simulation chatters by is no reading's fault.
LEAST = {"x": 2e-5, "z": 2e-5, "fx": 1.0, "fz": 1.0, "torque": 0.1}


def outlier_times(run: RunFit) -> dict[str, np.ndarray]:
    """Times of readings that stand out from their neighbours [s], by channel; only those with some.

    Args:
        run: Fitted: judged is what the simulation leaves, which is smoother than the readings.
    """
    found = {}
    for channel, residual in run.residuals.items():
        values, time = residual[run.counts], run.time[run.counts]
        if len(values) < AROUND:
            continue
        noise = max(white_noise(values), LEAST[channel])
        out = np.abs(values - median_filter(values, AROUND)) > STANDS_OUT * noise
        if out.any():
            found[channel] = time[out]
    return found


def outlier_sentences(runs: Sequence[RunFit]) -> list[str]:
    """Sentences on runs whose readings hold outliers."""
    told = []
    for run in runs:
        for channel, times in outlier_times(run).items():
            number = f"{len(times)} readings" if len(times) > 1 else "one reading"
            stand, first = ("stand", ", the first") if len(times) > 1 else ("stands", "")
            told.append(
                f"{run.name}: {number} of {channel} {stand} out by over {STANDS_OUT:g} times the "
                f"noise{first} at {times[0]:.4g} s; all channels are weighed by what is left, so "
                "take such readings out"
            )
    return told


def moving_start_sentences(runs: Sequence[RunFit]) -> list[str]:
    """Sentences on runs that begin while the wheel turns, with a carriage taken to be at rest."""
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
