"""Runs that do not fit the others, which an operator should look at before any effect."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.repeatability import ZetaResponse, repeat_difference, repeats
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.linear.regressors import Regressors
from diagnose.localization.shares import GapShare
from drftjax.recorded.observation import SHOWN

REPEATS_DIFFER = "repeat each other and differ by"
"""Words of every sentence on repeats that disagree."""


@dataclass(frozen=True)
class OutlierRunSettings:
    """Thresholds for runs that do not fit the others.

    Attributes:
        min_noise_ratio: Repeats disagree where they differ by so many times the noise of the
            instruments and the discretisation error [-],
        min_gap_share: and by more than this share of the gap [-].
        zeta_scatters: The zeta of a run is an outlier where it lies beyond the others' by so many of
            their standard deviations [-],
        zeta_distance: and by so much of a logarithm [-]: sand that is prepared alike scatters by a
            per cent or a few.
        min_other_runs: Runs that one is compared with at least.
        run_share: One run carries the gap where it has this share of it [-],
        run_time_ratio: and so many times its share of the time [-].
    """

    min_noise_ratio: float = 3.0
    min_gap_share: float = 0.5
    zeta_scatters: float = 5.0
    zeta_distance: float = 0.05
    min_other_runs: int = 4
    run_share: float = 0.5
    run_time_ratio: float = 3.0


DEFAULT_OUTLIER_RUNS = OutlierRunSettings()


def outliers_among_repeats(
    dataset: RigDataset,
    residuals: Sequence[list[np.ndarray]],
    own: Mapping[str, float],
    response: ZetaResponse,
    settings: OutlierRunSettings = DEFAULT_OUTLIER_RUNS,
) -> list[str]:
    """Sentences on repeats that differ by more than any effect of command, load or state explains.

    Args:
        dataset: The runs.
        residuals: By model and run, simulated minus recorded [m, N, N m], shape (channels,
            samples), the reference model first: the smallest difference counts.
        own: Discretisation error of the simulation in each channel [m, N, N m].
        response: Derivative of a run's channels by its log zeta; see
            `diagnose.gap.repeatability.repeat_difference`.
        settings: Thresholds.
    """
    differences: dict[tuple[int, int], list[str]] = {}
    for index, channel in enumerate(dataset.channels):
        for pair in repeats(dataset, channel):
            differ = min(
                _rms(repeat_difference(dataset, pair, each, response)[index]) for each in residuals
            )
            gap = _rms(np.concatenate([residuals[0][run][index] for run in pair]))
            noise = math.hypot(own[channel], *(_noise(dataset, run, channel) for run in pair))
            if differ > max(settings.min_noise_ratio * noise, settings.min_gap_share * gap):
                unit, scale = SHOWN[channel]
                differences.setdefault(pair, []).append(
                    f"{scale * differ:.2g} {unit} in {channel}, {differ / noise:.0f} times what "
                    "instruments and plates make"
                )
    return [
        f"{' and '.join(dataset.runs[run].name for run in pair)} {REPEATS_DIFFER} "
        f"{'; by '.join(by)}: no effect of command, load or state does that. Was the sand "
        "prepared alike, and z zeroed alike?"
        for pair, by in differences.items()
    ]


def outliers_by_zeta(
    regressors: Regressors,
    chosen: Hypothesis,
    settings: OutlierRunSettings = DEFAULT_OUTLIER_RUNS,
) -> list[str]:
    """One sentence on the run whose zeta is far from those of all others; empty without one.

    Args:
        regressors: Of the dataset.
        chosen: The effects added, or the reference model.
        settings: Thresholds.
    """
    zetas = chosen.log_zeta + regressors.log_reference_zeta
    if len(zetas) <= settings.min_other_runs:
        return []
    outlier = int(np.argmax(np.abs(zetas - np.median(zetas))))
    others = np.delete(zetas, outlier)
    lowest, highest = float(others.min()), float(others.max())
    distance = abs(float(zetas[outlier] - np.clip(zetas[outlier], lowest, highest)))
    scatter = float(np.std(others, ddof=1))
    if distance < max(settings.zeta_distance, settings.zeta_scatters * scatter):
        return []
    dataset = regressors.dataset
    unit, scale = SHOWN["z"]
    by_zeta = float(chosen.columns[outlier][dataset.channels.index("z"), :, 0].mean())
    sinkage = scale * distance * abs(by_zeta)
    return [
        f"The zeta of {dataset.runs[outlier].name} is {np.exp(zetas[outlier]):.4g}, of the others "
        f"{np.exp(lowest):.4g} to {np.exp(highest):.4g}: its sand was prepared otherwise, its z "
        f"zeroed elsewhere (by about {sinkage:.2g} {unit}), or an effect bears on it as on no "
        "other, as may be where it alone has its load, speed or length."
    ]


def gap_carried_by_one_run(
    dataset: RigDataset,
    shares: Sequence[GapShare],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
    settings: OutlierRunSettings = DEFAULT_OUTLIER_RUNS,
) -> list[str]:
    """One sentence on the run that has most of the gap, and the gap without it; empty without one.

    Args:
        dataset: The runs.
        shares: Shares of the gap by axis.
        before: By run, simulated minus recorded by the reference model [m, N, N m], shape
            (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
        settings: Thresholds.
    """
    runs = [each for each in shares if each.axis == "run"]
    largest = max(runs, key=lambda each: each.share, default=None)
    if largest is None or len(runs) <= settings.min_other_runs:
        return []
    if largest.share < max(settings.run_share, settings.run_time_ratio * largest.time):
        return []
    named = zip(dataset.runs, before, strict=True)
    others = [residual for run, residual in named if run.name != largest.label]
    remaining = {
        channel: _rms(np.concatenate([each[index] for each in others])) / floors[channel]
        for index, channel in enumerate(dataset.channels)
    }
    gap = [
        f"{size:.1f} noise floors in {channel}"
        for channel, size in remaining.items()
        if np.isfinite(size)
    ]
    return [
        f"{largest.label} holds {largest.share:.0%} of the gap in {largest.time:.0%} of the time; "
        f"the gap of the other runs alone would be {' and '.join(gap)}. Look at its record first."
    ]


def _noise(dataset: RigDataset, run: int, channel: str) -> float:
    """White noise of an instrument in one run; 0 where it was not recorded [m, N, N m]."""
    return dataset.runs[run].observation.by_channel().get(channel, ((), 0.0))[1]


def _rms(values: np.ndarray) -> float:
    """Root mean square of the finite values; NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
