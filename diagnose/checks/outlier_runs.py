"""Runs that do not go with the others, which an operator should look at before any effect."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.gap.repeatability import ZetaResponse, repeat_difference, repeats
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.linear.regressors import Regressors
from diagnose.localization.shares import GapShare
from drftjax.recorded.observation import SHOWN

# Repeats disagree where they differ by so many times what instruments and plates make, and by more
# than this share of the gap.
DISAGREE, OF_GAP = 3.0, 0.5


# Words of every sentence on such repeats.
REPEATS_DIFFER = "repeat each other and differ by"


# A run's zeta is odd where it lies beyond the others' by so many of their scatters, and by so much
# [of a logarithm]: sand that is prepared alike scatters by a per cent or a few.
ODD_SCATTERS, ODD_ZETA = 5.0, 0.05


# The fewest others that a run is held against.
FEWEST = 4


# One run holds a gap where it has this share of it, and so many times its share of the time.
MOST, TIMES = 0.5, 3.0


def outliers_among_repeats(
    case: RigDataset,
    residuals: Sequence[list[np.ndarray]],
    own: Mapping[str, float],
    response: ZetaResponse,
) -> list[str]:
    """Repeats that differ by what no effect of command, load or state can make, in sentences.

    Args:
        case: The runs.
        residuals: By model and run, simulated less recorded, the reference model first: the
            smallest difference counts.
        own: The simulation's own error in each channel [m, N, N m].
        response: Change of a run's channels by its log zeta; see
        `diagnose.gap.repeatability.repeat_difference`.
    """
    told: dict[tuple[int, int], list[str]] = {}
    for index, channel in enumerate(case.channels):
        for pair in repeats(case, channel):
            differ = min(
                _rms(repeat_difference(case, pair, each, response)[index]) for each in residuals
            )
            whole = _rms(np.concatenate([residuals[0][run][index] for run in pair]))
            alone = math.hypot(own[channel], *(_noise(case, run, channel) for run in pair))
            if differ > max(DISAGREE * alone, OF_GAP * whole):
                unit, scale = SHOWN[channel]
                told.setdefault(pair, []).append(
                    f"{scale * differ:.2g} {unit} in {channel}, {differ / alone:.0f} times what "
                    "instruments and plates make"
                )
    return [
        f"{' and '.join(case.runs[run].name for run in pair)} {REPEATS_DIFFER} "
        f"{'; by '.join(by)}: no effect of command, load or state does that. Was the sand "
        "prepared alike, and z zeroed alike?"
        for pair, by in told.items()
    ]


def outliers_by_zeta(bench: Regressors, chosen: Hypothesis) -> list[str]:
    """The run whose zeta is far from all others', if there is one.

    Args:
        bench: The case.
        chosen: The effects added, or the reference model.
    """
    zetas = chosen.log_zeta + bench.log_reference_zeta
    if len(zetas) <= FEWEST:
        return []
    odd = int(np.argmax(np.abs(zetas - np.median(zetas))))
    others = np.delete(zetas, odd)
    least, most = float(others.min()), float(others.max())
    away = abs(float(zetas[odd] - np.clip(zetas[odd], least, most)))
    if away < max(ODD_ZETA, ODD_SCATTERS * float(np.std(others, ddof=1))):
        return []
    z = bench.dataset.channels.index("z")
    unit, scale = SHOWN["z"]
    sinkage = scale * away * abs(float(chosen.columns[odd][z, :, 0].mean()))
    return [
        f"The zeta of {bench.dataset.runs[odd].name} is {np.exp(zetas[odd]):.4g}, of the others "
        f"{np.exp(least):.4g} to {np.exp(most):.4g}: its sand was prepared otherwise, its z zeroed "
        f"elsewhere (by about {sinkage:.2g} {unit}), or an effect bears on it as on no other, as "
        "may be where it alone has its load, speed or length."
    ]


def gap_carried_by_one_run(
    case: RigDataset,
    places: Sequence[GapShare],
    before: Sequence[np.ndarray],
    floors: Mapping[str, float],
) -> list[str]:
    """The run that holds most of the gap, and what is left without it.

    Args:
        case: The runs.
        places: Shares of the gap by axis.
        before: By run, simulated less recorded by the reference model, shape (channels, samples).
        floors: Noise floor of each channel [m, N, N m].
    """
    runs = [each for each in places if each.axis == "run"]
    most = max(runs, key=lambda each: each.share, default=None)
    if most is None or len(runs) <= FEWEST or most.share < max(MOST, TIMES * most.time):
        return []
    named = zip(case.runs, before, strict=True)
    others = [each for candidate, each in named if candidate.name != most.label]
    left = {
        channel: _rms(np.concatenate([each[index] for each in others])) / floors[channel]
        for index, channel in enumerate(case.channels)
    }
    told = [f"{x:.1f} noise floors in {channel}" for channel, x in left.items() if np.isfinite(x)]
    return [
        f"{most.label} holds {most.share:.0%} of the gap in {most.time:.0%} of the time; the gap "
        f"of the other runs alone would be {' and '.join(told)}. Look at its record first."
    ]


def _noise(case: RigDataset, run: int, channel: str) -> float:
    return case.runs[run].observation.by_channel().get(channel, ((), 0.0))[1]


def _rms(values: np.ndarray) -> float:
    """Root mean square of what was recorded; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
