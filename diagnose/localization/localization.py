"""Localisation of the gap between runs and model: shares by run, phase, state and frequency."""

from collections.abc import Mapping, Sequence

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.localization.by_frequency import by_hertz, by_order, unmarked_orders
from diagnose.localization.by_state import by_state
from diagnose.localization.kinematics import PHASES, kinematics_of_run
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.localization.shares import (
    GapShare,
    Partition,
    RunMisfit,
    bootstrap_counts,
    partition_by_bin,
    partition_by_label,
    shares_of,
)
from drftjax.recorded.prepared_run import PreparedRun


def localize(
    dataset: RigDataset,
    residual: list[np.ndarray],
    floor: Mapping[str, float],
    settings: LocalizationSettings = DEFAULT_LOCALIZATION,
) -> list[GapShare]:
    """Shares of the gap on every axis, each with an interval.

    Args:
        dataset: The runs.
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
        floor: Noise floor of each channel in the same unit.
        settings: Bins and bootstrap.

    Returns:
        Shares that add up to one on each axis; empty where there is no gap. Of travel, its change
        from one half second to the next counts, so that one early slip does not count for ever.
    """
    numbers = [run for run, each in enumerate(residual) if each.size]
    runs = [_misfit(dataset, run, residual[run], floor, settings) for run in numbers]
    total = sum(run.whole for run in runs)
    if not total > 0:
        return []
    prepared = [dataset.runs[run] for run in numbers]
    names = [each.name for each in prepared]
    loads, profiles = _loads(prepared), _profiles(prepared)
    random = np.random.default_rng(settings.seed)
    sizes = [int(run.motion.bins.max()) + 1 for run in runs]
    # The share of a run is a property of that run: only its half seconds are drawn again. The runs
    # of a load, or of a profile, are drawn too, as a sample of that load or profile.
    grouped = {
        "run": bootstrap_counts(random, sizes, list(range(len(runs))), settings.draws),
        "load": bootstrap_counts(random, sizes, loads, settings.draws),
        "profile": bootstrap_counts(random, sizes, profiles, settings.draws),
    }
    drawn = bootstrap_counts(random, sizes, [0] * len(runs), settings.draws)
    partitions = [
        partition_by_label(runs, axis, of)
        for axis, of in (("run", names), ("load", loads), ("profile", profiles))
    ]
    partitions += [partition_by_bin(runs, "phase", PHASES, [run.motion.phase for run in runs])]
    partitions += by_state(runs, settings)
    partitions += [
        by_hertz(runs, settings),
        by_order(runs, settings),
        _by_channel(runs, dataset.channels),
    ]
    return [
        share
        for each in partitions
        for share in shares_of(each, grouped.get(each.axis, drawn), total, settings)
    ]


def localization_sentence(
    shares: Sequence[GapShare], settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> str:
    """The main places of the gap, in one sentence.

    A bin is named where its interval lies above the share of the time spent in it (or an even
    share), in the order of its Kullback-Leibler term p ln(p / q), at most `max_named` of them.

    Args:
        shares: By `localize`.
        settings: Thresholds.
    """
    if not shares:
        return "There is no gap to speak of."
    named = _named_shares(shares, settings)
    if not named:
        return "The gap is spread about evenly over runs, phases and states."
    parts = []
    of_travel = any(each.axis == "channel" and each.label == "x" for each in shares)
    most, least = settings.most_share, settings.min_named_share
    for word, low, high in (("Most", most, np.inf), ("Much", least, most)):
        places = [_in_words(each, of_travel) for each in named if low <= each.share < high]
        if places:
            whole = f"{word.lower()} of it" if parts else f"{word} of the gap lies"
            parts.append(f"{whole} {'; '.join(places)}")
    return "; ".join(parts) + "."


def _named_shares(shares: Sequence[GapShare], settings: LocalizationSettings) -> list[GapShare]:
    """Shares that the sentence names, the most telling first."""
    axes: dict[str, list[GapShare]] = {}
    for each in shares:
        axes.setdefault(each.axis, []).append(each)
    unmarked = unmarked_orders(settings)
    ranked = []
    for axis, parts in axes.items():
        if len(parts) < 2 or axis in ("run", "frequency", "stage"):
            continue
        for part in parts:
            even = settings.marked_order_share if axis == "order" else 1 / len(parts)
            expected = part.time if np.isfinite(part.time) else even
            sure = part.interval[0] > expected and part.share > settings.min_named_share
            if sure and not (axis == "order" and part.label in unmarked):
                ranked.append((part.share * np.log(part.share / max(expected, 1e-3)), part))
    ranked.sort(key=lambda each: -each[0])
    chosen: dict[str, GapShare] = {}
    for _, part in ranked:
        # A profile is fast or slow: one of the two is enough.
        kind = "speed" if part.axis in ("profile", "angular velocity") else part.axis
        if len(chosen) < settings.max_named:
            chosen.setdefault(kind, part)
    return [*chosen.values()]


def _in_words(part: GapShare, of_travel: bool) -> str:
    beside = " beside the changes of x" if of_travel and part.label != "x" else ""
    place = {
        "phase": f"in the phase “{part.label}”",
        "channel": f"in {part.label}{beside}",
        "order": f"{part.label}",
        "load": f"at {part.label}",
        "profile": f"in the profile {part.label}",
    }.get(part.axis, f"at {part.axis} {part.label}")
    spent = f" in {part.time:.0%} of the time" if np.isfinite(part.time) else ""
    return f"{place} ({part.share:.0%} of it{spent})"


def _misfit(
    dataset: RigDataset,
    run: int,
    residual: np.ndarray,
    floor: Mapping[str, float],
    settings: LocalizationSettings,
) -> RunMisfit:
    """A run's residual in noise floors, with the changes of x from one half second to the next."""
    splitter = SlowFastSplit.of(dataset.time(run))
    scaled = np.zeros(residual.shape)
    for row, channel in enumerate(dataset.channels):
        values = residual[row]
        if not np.isfinite(values).all():
            continue
        if channel == "x":
            parts = splitter.split("x", values[:, None])
            change = np.r_[0.0, parts["slow"][:, 0]]
            values = splitter.interpolation @ change + parts["fast"][:, 0]
        scaled[row] = values / floor[channel]
    motion = kinematics_of_run(dataset, run, splitter, settings)
    return RunMisfit(motion, scaled, dataset.sample_interval(run))


def _loads(runs: Sequence[PreparedRun]) -> list[str]:
    """Label of each run's load: the masses that differ, and the drawbar load where it differs."""
    rigs = [each.setup.rig for each in runs]
    drawn = len({rig.drawbar_load for rig in rigs}) > 1
    carried = len({rig.mass_x for rig in rigs}) > 1 and len({rig.mass_z for rig in rigs}) == 1
    labels = []
    for rig in rigs:
        label = f"{rig.mass_x:.4g} kg carried" if carried else f"{rig.mass_z:.4g} kg on the wheel"
        labels.append(label + (f", {rig.drawbar_load:.3g} N drawn" if drawn else ""))
    return labels


def _profiles(runs: Sequence[PreparedRun]) -> list[str]:
    """Label of each run's command: top speed and duration, numbered where these are equal."""
    labels: dict[tuple, str] = {}
    found = []
    for each in runs:
        trial = each.trial
        knots = tuple(np.round(np.r_[trial.time, trial.omega, trial.vx], 6))
        if knots not in labels:
            fastest = np.rad2deg(float(np.abs(np.asarray(trial.omega)).max()))
            duration = each.rest_left_out + float(trial.time[-1])
            label = f"up to {fastest:.3g} deg/s in {duration:.3g} s"
            alike = sum(other.split(" (")[0] == label for other in labels.values())
            labels[knots] = f"{label} ({alike + 1})" if alike else label
        found.append(labels[knots])
    return found


def _by_channel(runs: Sequence[RunMisfit], channels: Sequence[str]) -> Partition:
    power = [run.in_bins(run.motion.bins, run.residual**2) for run in runs]
    return Partition("channel", channels, power)
