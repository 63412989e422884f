"""Where the gap between runs and model lies: its shares by run, phase, state and frequency."""

from collections.abc import Sequence

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.localization.by_frequency import NO_PERIOD, by_hertz, by_order
from diagnose.localization.by_state import by_state
from diagnose.localization.kinematics import PHASES, kinematics_of_run
from diagnose.localization.shares import (
    LEAST_TOLD,
    MOST,
    MOST_TOLD,
    SEED,
    GapShare,
    Partition,
    RunMisfit,
    bootstrap_counts,
    partition_by_bin,
    partition_by_label,
    shares_of,
)

# Share of the gap that a marked order (once a turn, grousers, a line) holds where nothing is there.
MARKED = 0.05


def localize(
    case: RigDataset, residual: list[np.ndarray], floor: dict[str, float]
) -> list[GapShare]:
    """Shares of the gap, each with an interval.

    Args:
        case: The runs.
        residual: By run: simulated less recorded, shape (channels, samples) [m, N, N m].
        floor: Noise floor of each channel in the same unit.

    Returns:
        Shares that add up to one on each axis; none where there is no gap. Of travel, its change
        from one half second to the next counts, so that one early slip does not count for ever.
    """
    runs = [_run(case, number, each, floor) for number, each in enumerate(residual) if each.size]
    total = sum(run.whole for run in runs)
    if not total > 0:
        return []
    candidates = [case.runs[k] for k, each in enumerate(residual) if each.size]
    names, loads, profiles = (
        [each.name for each in candidates],
        _loads(candidates),
        _profiles(candidates),
    )
    random = np.random.default_rng(SEED)
    sizes = [int(run.motion.bins.max()) + 1 for run in runs]
    # A run's share says what that run did: only its half seconds are drawn again, not the run;
    # and the runs of a load, or of a profile, stand for that load or profile.
    grouped = {
        "run": bootstrap_counts(random, sizes, list(range(len(runs)))),
        "load": bootstrap_counts(random, sizes, loads),
        "profile": bootstrap_counts(random, sizes, profiles),
    }
    drawn = bootstrap_counts(random, sizes, [0] * len(runs))
    cuts = [
        partition_by_label(runs, axis, of)
        for axis, of in (("run", names), ("load", loads), ("profile", profiles))
    ]
    cuts += [partition_by_bin(runs, "phase", PHASES, [run.motion.phase for run in runs])]
    cuts += by_state(runs)
    cuts += [by_hertz(runs), by_order(runs), _by_channel(runs, case.channels)]
    return [share for cut in cuts for share in shares_of(cut, grouped.get(cut.axis, drawn), total)]


def localization_sentence(shares: Sequence[GapShare]) -> str:
    """Where the gap lies, in one plain sentence.

    The bins that hold most beyond the time spent in them are named, at most three.
    """
    if not shares:
        return "There is no gap to speak of."
    axes: dict[str, list[GapShare]] = {}
    for each in shares:
        axes.setdefault(each.axis, []).append(each)
    told = []
    for axis, parts in axes.items():
        if len(parts) < 2 or axis in ("run", "frequency", "stage"):
            continue
        for part in parts:
            even = MARKED if axis == "order" else 1 / len(parts)
            expected = part.time if np.isfinite(part.time) else even
            sure = part.interval[0] > expected and part.share > LEAST_TOLD
            if sure and not (axis == "order" and part.label in NO_PERIOD):
                told.append((part.share * np.log(part.share / max(expected, 1e-3)), part))
    told.sort(key=lambda each: -each[0])
    chosen: dict[str, GapShare] = {}
    for _, part in told:
        # A profile is fast or slow: one of the two says it.
        kind = "speed" if part.axis in ("profile", "angular velocity") else part.axis
        if len(chosen) < MOST_TOLD:
            chosen.setdefault(kind, part)
    if not chosen:
        return "The gap is spread about evenly over runs, phases and states."
    said = []
    of_travel = any(each.label == "x" for each in axes.get("channel", ()))
    for much, least, below in (("Most", MOST, np.inf), ("Much", LEAST_TOLD, MOST)):
        places = [
            _in_words(each, of_travel) for each in chosen.values() if least <= each.share < below
        ]
        if places:
            whole = f"{much.lower()} of it" if said else f"{much} of the gap lies"
            said.append(f"{whole} {'; '.join(places)}")
    return "; ".join(said) + "."


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


def _run(case: RigDataset, number: int, residual: np.ndarray, floor: dict[str, float]) -> RunMisfit:
    splitter = SlowFastSplit.of(case.time(number))
    error = np.zeros(residual.shape)
    for row, channel in enumerate(case.channels):
        values = residual[row]
        if not np.isfinite(values).all():
            continue
        if channel == "x":
            parts = splitter.split("x", values[:, None])
            change = np.r_[0.0, parts["slow"][:, 0]]
            values = splitter.interpolation @ change + parts["fast"][:, 0]
        error[row] = values / floor[channel]
    return RunMisfit(kinematics_of_run(case, number, splitter), error, case.sample_interval(number))


def _loads(candidates: Sequence) -> list[str]:
    rigs = [each.setup.rig for each in candidates]
    drawn = len({rig.drawbar_load for rig in rigs}) > 1
    carried = len({rig.mass_x for rig in rigs}) > 1 and len({rig.mass_z for rig in rigs}) == 1
    labels = []
    for rig in rigs:
        label = f"{rig.mass_x:.4g} kg carried" if carried else f"{rig.mass_z:.4g} kg on the wheel"
        labels.append(label + (f", {rig.drawbar_load:.3g} N drawn" if drawn else ""))
    return labels


def _profiles(candidates: Sequence) -> list[str]:
    labels: dict[tuple, str] = {}
    found = []
    for each in candidates:
        trial = each.trial
        knots = tuple(np.round(np.r_[trial.time, trial.omega, trial.vx], 6))
        if knots not in labels:
            fastest = np.rad2deg(float(np.abs(np.asarray(trial.omega)).max()))
            label = f"up to {fastest:.3g} deg/s in {float(trial.time[-1]):.3g} s"
            alike = sum(other.split(" (")[0] == label for other in labels.values())
            labels[knots] = f"{label} ({alike + 1})" if alike else label
        found.append(labels[knots])
    return found


def _by_channel(runs: Sequence[RunMisfit], channels: Sequence[str]) -> Partition:
    power = [run.in_bins(run.motion.bins, run.error**2) for run in runs]
    return Partition("channel", channels, power)
