"""The gap cut by what comes again: by frequency, and by order of rotation."""

import itertools
from collections.abc import Sequence

import numpy as np

from diagnose.localization.kinematics import PHASES, RunKinematics
from diagnose.localization.shares import Partition, RunMisfit
from diagnose.localization.spectrum import (
    HERTZ_LABELS,
    LINE_FROM,
    LINE_GAIN,
    LINE_SHARE,
    LINE_WIDTH,
    ORDER_FROM,
    ORDER_TO,
    ORDER_WIDTH,
    STANDS,
    SharedLine,
    in_hertz,
    in_turning,
    power_by_hertz,
    power_by_order,
    resample,
)

SLOWER, OTHER = "slower than once a turn", "other orders of the drive"


ONCE, UNPARTED = "once a turn", "once a turn or slower"


# In fewer turns than these a drift passes for a period.
FEWEST_TURNS = 3.0


# Bins of the orders that name no period.
NO_PERIOD = (SLOWER, UNPARTED, OTHER, STANDS, f"over {ORDER_TO:g} a turn")


# Place of a line and its share of its octave, see `Line.strongest`.
Strongest = tuple[float, float]


def by_hertz(runs: Sequence[RunMisfit]) -> Partition:
    """The axis of frequencies [Hz]."""
    power = []
    for run in runs:
        found = sum(power_by_hertz(run.motion.time, row) for row in run.error)
        power.append(_whole(run, run.in_bins(run.motion.bins, np.asarray(found))))
    return Partition("frequency", HERTZ_LABELS, power)


def _whole(run: RunMisfit, found: np.ndarray) -> np.ndarray:
    """Powers made to add up to the run's: interpolation loses some of the fastest."""
    total = found.sum()
    return found * (run.whole / total) if total > 0 else found


def by_order(runs: Sequence[RunMisfit]) -> Partition:
    """The axis of periods in a turn, of what keeps its frequency, and of what stands."""
    in_time, over_turning = _lines(runs)
    hertz = _shared_hertz(in_time, over_turning)
    grousers = runs[0].motion.grousers
    drive = _shared_order(over_turning, grousers) if hertz is None else None
    edges, parted = _orders(grousers, drive)
    told = [_parted(run, parted) for run in runs]
    fixed = f"at {hertz:.2g} Hz, whatever the speed" if hertz is not None else "at fixed hertz"
    labels = [*dict.fromkeys(itertools.chain(*sorted(told, key=lambda each: UNPARTED in each)))]
    labels += [fixed, STANDS]
    power = []
    for run, names in zip(runs, told, strict=True):
        motion = run.motion
        stands = _stands(motion)
        found = np.zeros((int(motion.bins.max()) + 1, len(labels)))
        for row in run.error:
            rest = row
            if hertz is not None:
                line = in_hertz(motion.time, row, (hertz - LINE_WIDTH, hertz + LINE_WIDTH))[1]
                rest = row - line
                found[:, -2] += run.in_bins(motion.bins, line[None] ** 2)[:, 0]
            found[:, -1] += run.in_bins(motion.bins, (np.where(stands, rest, 0) ** 2)[None])[:, 0]
            series, step, when = in_turning(motion.time, motion.turning, rest, stands)
            if not len(series):
                moving = np.where(stands, 0, rest) ** 2
                found[:, -1] += run.in_bins(motion.bins, moving[None])[:, 0]
                continue
            place = np.interp(when, motion.time, motion.bins).round().astype(int)
            within = power_by_order(series, step, edges)
            within *= (rest[~stands] ** 2).sum() / max(float(within.sum()), 1e-300)
            for name, values in zip(names, run.in_bins(place, within).T, strict=True):
                found[:, labels.index(name)] += values
        power.append(_whole(run, found))
    return Partition("order", labels, power)


def _orders(grousers: int, drive: float | None) -> tuple[tuple[float, ...], list[str]]:
    """Edges between bands of periods in a turn, and the name of each band."""
    marks = [(1.0, ONCE)]
    if grousers > 1:
        passing = f"grouser passing ({grousers} a turn)"
        marks += [(float(grousers), passing), (2.0 * grousers, passing)]
    if drive is not None:
        marks.append((drive, f"drive order {drive:.2g}"))
    edges: list[float] = []
    names: list[str] = []
    for at, name in sorted(marks):
        between = SLOWER if not names else OTHER
        edges += [at - ORDER_WIDTH, at + ORDER_WIDTH]
        names += [between, name]
    if edges[-1] < ORDER_TO:
        edges.append(ORDER_TO)
        names.append(OTHER)
    return tuple(edges), [*names, f"over {ORDER_TO:g} a turn"]


def _parted(run: RunMisfit, names: Sequence[str]) -> list[str]:
    """Names of the bands in one run."""
    if np.ptp(run.motion.turning) >= FEWEST_TURNS * 2 * np.pi:
        return list(names)
    return [UNPARTED if name in (SLOWER, ONCE) else name for name in names]


def _stands(motion: RunKinematics) -> np.ndarray:
    """Samples at which the wheel is not asked to turn, or has not turned."""
    stands = np.isin(motion.phase, [PHASES.index("stand"), PHASES.index("rest")])
    return stands | np.r_[True, np.diff(motion.turning) <= 0]


def _series(run: RunMisfit, unit: float):
    """Every channel's even series in time and over turning, in some unit, each with its step."""
    motion, stands = run.motion, _stands(run.motion)
    for row in run.error / unit:
        yield resample(motion.time, row), in_turning(motion.time, motion.turning, row, stands)[:2]


def _lines(runs: Sequence[RunMisfit]) -> tuple[Strongest, Strongest]:
    """The strongest line over time [Hz] and over turning, each with its share of its octave."""
    steps = [float(np.diff(run.motion.time).mean()) for run in runs if len(run.motion.time) > 1]
    hertz = SharedLine(LINE_FROM, 0.5 / max(steps, default=1.0), LINE_WIDTH)
    order = SharedLine(ORDER_FROM, ORDER_TO, ORDER_WIDTH)
    for run in runs:
        whole = np.sqrt(max(float(run.power.sum()), 1e-300))
        for in_time, over_turning in _series(run, whole):
            hertz.add(*in_time)
            order.add(*over_turning)
    return hertz.strongest(), order.strongest()


def _shared_hertz(in_time: Strongest, over_turning: Strongest) -> float | None:
    """A frequency that the error keeps at every speed [Hz]; None without one."""
    (at, share), (_, other) = in_time, over_turning
    return at if share > LINE_SHARE and share > LINE_GAIN * other else None


def _shared_order(over_turning: Strongest, grousers: int) -> float | None:
    """Periods in a turn that the error keeps, other than the grousers'; None without any."""
    at, share = over_turning
    known = [1.0, *(k * grousers for k in (1, 2) if grousers)]
    near = any(abs(at - each) < 2 * ORDER_WIDTH for each in known)
    return at if share > LINE_SHARE and not near else None
