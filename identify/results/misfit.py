"""Residuals that a fit leaves, in noise floors, and from when on the fit is a poor one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drftjax.recorded.observation import SHOWN
from identify.results.noise_floor import fast_scatter, noise_floor
from identify.results.values import RunFit
from identify.uncertainty.model_error import MISFIT_SETTINGS, MODEL_ERROR, MisfitSettings

POOR_FIT = "poor fit"
"""Status of a run, or a fit, that the solver has found and the model does not meet."""


def channel_floors(runs: Sequence[RunFit]) -> dict[str, float]:
    """Noise floor by channel [m, N, N m]: of repeats or readings, and what the simulation resolves.

    Args:
        runs: Fitted runs.
    """
    scatter, repeated = fast_scatter(runs), noise_floor(runs)
    channels = dict.fromkeys(channel for run in runs for channel in run.channels)
    return {
        each: max(scatter.get(each, 0.0), repeated.get(each, 0.0), MODEL_ERROR[each])
        for each in channels
    }


def in_floors(run: RunFit, floors: Mapping[str, float]) -> dict[str, float]:
    """Residual of a run after the fit, by channel, in noise floors [-]."""
    return {channel: left / floors[channel] for channel, left in run.rmse().items()}


def channels_off(
    run: RunFit, floors: Mapping[str, float], settings: MisfitSettings = MISFIT_SETTINGS
) -> list[str]:
    """Channels of a run that the model does not meet.

    Args:
        run: The fitted run.
        floors: Noise floor by channel [m, N, N m].
        settings: Decision numbers.
    """
    ranges = dict(zip(run.channels, np.ptp(run.recorded[:, run.counts], axis=1), strict=True))
    return [
        channel
        for channel, left in run.rmse().items()
        if left > max(settings.poor * floors[channel], settings.noticeable * ranges[channel])
    ]


def short(floors: float) -> str:
    """A number of noise floors in two digits, or whole: "2.4", "110"."""
    return f"{floors:.2g}" if floors < 10 else f"{floors:.0f}"


def judged(
    runs: Sequence[RunFit],
    floors: Mapping[str, float],
    settings: MisfitSettings = MISFIT_SETTINGS,
) -> list[RunFit]:
    """The runs, those that converged and are off by more than chance called a poor fit.

    Args:
        runs: Fitted runs.
        floors: Noise floor by channel [m, N, N m].
        settings: Decision numbers.
    """
    return [
        replace(run, status=POOR_FIT)
        if run.status == "converged" and channels_off(run, floors, settings)
        else run
        for run in runs
    ]


def overall(status: str, runs: Sequence[RunFit]) -> str:
    """Status of a whole fit: the solver's, or "poor fit" where it converged and a run is one."""
    poor = any(run.status == POOR_FIT for run in runs)
    return POOR_FIT if status == "converged" and poor else status


def misfit_sentences(
    runs: Sequence[RunFit],
    floors: Mapping[str, float],
    settings: MisfitSettings = MISFIT_SETTINGS,
) -> list[str]:
    """Sentences on channels that the model does not meet, and on those that got worse.

    Args:
        runs: Fitted runs.
        floors: Noise floor by channel [m, N, N m].
        settings: Decision numbers.
    """
    runs = [run for run in runs if run.status != "diverged"]
    sentences, off = [], []
    for channel, floor in floors.items():
        of_channel = [run for run in runs if channel in run.channels]
        if not of_channel:
            continue
        before, after = (_pooled(of_channel, channel, fitted) for fitted in (False, True))
        worst = max(of_channel, key=lambda run: run.rmse()[channel])
        unit, scale = SHOWN[channel]
        if any(channel in channels_off(run, floors, settings) for run in of_channel):
            off.append(
                f"{channel} by {short(after / floor)} noise floors of {floor * scale:.2g} {unit} "
                f"(most in {worst.name}: {short(worst.rmse()[channel] / floor)})"
            )
        if after > settings.worse * before and after > settings.poor * floor:
            sentences.append(
                f"{channel} is farther off than before the fit ({before * scale:.3g} → "
                f"{after * scale:.3g} {unit}): the other channels pulled it"
            )
    if off:
        sentences.insert(
            0,
            f"poor fit: the model is off in {' and '.join(off)}; the fitted values bend to what "
            "it lacks, perhaps by more than their errors. Next: drft diagnose RUNS looks for that",
        )
    return sentences


def _pooled(runs: Sequence[RunFit], channel: str, fitted: bool) -> float:
    power = sum(run.rmse(fitted)[channel] ** 2 * run.counts.sum() for run in runs)
    return float(np.sqrt(power / sum(run.counts.sum() for run in runs)))
