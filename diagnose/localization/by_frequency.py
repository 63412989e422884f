"""Partitions of the gap by frequency, and by order of the wheel's rotation."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from diagnose.localization.kinematics import PHASES, RunKinematics
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.localization.shares import Partition, RunMisfit
from diagnose.localization.spectrum import (
    STANDING_LABEL,
    SharedLine,
    in_hertz,
    in_turning,
    power_by_order,
    resample,
)

SLOWER_LABEL, OTHER_LABEL = "slower than once a turn", "other orders of the drive"
ONCE_LABEL, ONCE_OR_SLOWER_LABEL = "once a turn", "once a turn or slower"

Line = tuple[float, float]
"""Place of the strongest line and its share of its octave, see `SharedLine.strongest`."""


def unmarked_orders(settings: LocalizationSettings = DEFAULT_LOCALIZATION) -> tuple[str, ...]:
    """Bins of `by_order` that name no single period."""
    others = (SLOWER_LABEL, ONCE_OR_SLOWER_LABEL, OTHER_LABEL, STANDING_LABEL)
    return (*others, settings.beyond_orders)


def by_hertz(
    runs: Sequence[RunMisfit], settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> Partition:
    """Partition by frequency [Hz]."""
    power = []
    for run in runs:
        squares = [
            in_hertz(run.motion.time, row, settings.frequency_edges) ** 2 for row in run.residual
        ]
        power.append(_rescaled(run, run.in_bins(run.motion.bins, np.sum(squares, axis=0))))
    return Partition("frequency", settings.frequency_labels, power)


def _rescaled(run: RunMisfit, found: np.ndarray) -> np.ndarray:
    """Powers that add up to the run's: interpolation loses some of the fastest."""
    total = found.sum()
    return found * (run.whole / total) if total > 0 else found


def by_order(
    runs: Sequence[RunMisfit], settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> Partition:
    """Partition by periods a turn, a line of fixed frequency, and the time of standing."""
    in_time, over_turning = _strongest_lines(runs, settings)
    hertz = _fixed_frequency(in_time, over_turning, settings)
    grousers = runs[0].motion.grousers
    drive = _drive_order(over_turning, grousers, settings) if hertz is None else None
    edges, bands = _order_bands(grousers, drive, settings)
    names_of = [_names_in_run(run, bands, settings) for run in runs]
    fixed = f"at {hertz:.2g} Hz, whatever the speed" if hertz is not None else "at fixed hertz"
    in_order = sorted(names_of, key=lambda each: ONCE_OR_SLOWER_LABEL in each)
    labels = [*dict.fromkeys(itertools.chain(*in_order)), fixed, STANDING_LABEL]
    power = [
        _rescaled(run, _order_power(run, labels, names, edges, hertz, settings))
        for run, names in zip(runs, names_of, strict=True)
    ]
    return Partition("order", labels, power)


def _order_power(
    run: RunMisfit,
    labels: Sequence[str],
    names: Sequence[str],
    edges: tuple[float, ...],
    hertz: float | None,
    settings: LocalizationSettings,
) -> np.ndarray:
    """Power of one run in each half second and bin, shape (half seconds, labels).

    Args:
        run: The run.
        labels: Of all bins; the last two are the fixed frequency and standing.
        names: Of the bands of orders in this run.
        edges: Between these bands [periods a turn].
        hertz: Fixed frequency, whose line is taken out first; None without one.
        settings: Its width.
    """
    motion, stands = run.motion, _stands(run.motion)
    found = np.zeros((int(motion.bins.max()) + 1, len(labels)))
    for row in run.residual:
        rest = row
        if hertz is not None:
            around = (hertz - settings.line_width, hertz + settings.line_width)
            line = in_hertz(motion.time, row, around)[1]
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
    return found


def _order_bands(
    grousers: int, drive: float | None, settings: LocalizationSettings
) -> tuple[tuple[float, ...], list[str]]:
    """Edges between bands of periods a turn, and the name of each band."""
    marks = [(1.0, ONCE_LABEL)]
    if grousers > 1:
        passing = f"grouser passing ({grousers} a turn)"
        marks += [(float(grousers), passing), (2.0 * grousers, passing)]
    if drive is not None:
        marks.append((drive, f"drive order {drive:.2g}"))
    edges: list[float] = []
    names: list[str] = []
    for at, name in sorted(marks):
        between = OTHER_LABEL if names else SLOWER_LABEL
        edges += [at - settings.order_width, at + settings.order_width]
        names += [between, name]
    if edges[-1] < settings.max_order:
        edges.append(settings.max_order)
        names.append(OTHER_LABEL)
    return tuple(edges), [*names, settings.beyond_orders]


def _names_in_run(
    run: RunMisfit, names: Sequence[str], settings: LocalizationSettings
) -> list[str]:
    """Names of the bands in one run: in a few turns a drift looks like a period of one turn."""
    if np.ptp(run.motion.turning) >= settings.min_turns * 2 * np.pi:
        return list(names)
    slow = (SLOWER_LABEL, ONCE_LABEL)
    return [ONCE_OR_SLOWER_LABEL if name in slow else name for name in names]


def _stands(motion: RunKinematics) -> np.ndarray:
    """Mask of samples at which the wheel is not commanded to turn, or has not turned."""
    stands = np.isin(motion.phase, [PHASES.index("stand"), PHASES.index("rest")])
    return stands | np.r_[True, np.diff(motion.turning) <= 0]


def _even_series(run: RunMisfit, unit: float) -> Iterator[tuple[tuple, tuple]]:
    """Every channel's even series in time and over turning, over `unit`, each with its step."""
    motion, stands = run.motion, _stands(run.motion)
    for row in run.residual / unit:
        yield resample(motion.time, row), in_turning(motion.time, motion.turning, row, stands)[:2]


def _strongest_lines(
    runs: Sequence[RunMisfit], settings: LocalizationSettings
) -> tuple[Line, Line]:
    """The strongest line over time [Hz] and over turning [periods a turn]."""
    steps = [float(np.diff(run.motion.time).mean()) for run in runs if len(run.motion.time) > 1]
    fastest = 0.5 / max(steps, default=1.0)
    hertz = SharedLine(settings.min_line_frequency, fastest, settings.line_width, settings)
    order = SharedLine(settings.min_order, settings.max_order, settings.order_width, settings)
    for run in runs:
        whole = np.sqrt(max(float(run.power.sum()), 1e-300))
        for in_time, over_turning in _even_series(run, whole):
            hertz.add(*in_time)
            order.add(*over_turning)
    return hertz.strongest(), order.strongest()


def _fixed_frequency(
    in_time: Line, over_turning: Line, settings: LocalizationSettings
) -> float | None:
    """Frequency that the residual keeps at every speed [Hz]; None without one."""
    (at, share), (_, other) = in_time, over_turning
    enough = share > settings.min_line_share and share > settings.min_line_gain * other
    return at if enough else None


def _drive_order(over_turning: Line, grousers: int, settings: LocalizationSettings) -> float | None:
    """Periods a turn that the residual keeps, other than the grousers'; None without any."""
    at, share = over_turning
    known = [1.0, *(k * grousers for k in (1, 2) if grousers)]
    near = any(abs(at - each) < 2 * settings.order_width for each in known)
    return at if share > settings.min_line_share and not near else None
