"""A run in the loop as a figure: sinkage real and simulated, zeta, slip, lateness."""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.figures import (
    AFTER,
    BEFORE,
    COMMANDED,
    REAL,
    SIMULATED,
    STYLE,
    draw_floor,
    label_channel,
    label_difference,
    project_style,
    title_above,
)
from drftjax.runlog.figure import plot_run
from drftjax.runlog.record import Online, RunLog
from hils.events import FINDINGS, Event, TickFlag


class TickCounts(NamedTuple):
    """Ticks of a recorded run, counted as in the report at its end.

    Attributes:
        ticks: Ticks made.
        missed: Deadlines missed, those of skipped ticks included.
        skipped: Ticks that passed unused.
        without_reading: Ticks that had no reading not seen before.
    """

    ticks: int
    missed: int
    skipped: int
    without_reading: int


# A wheel that rolls slower has no slip worth drawing [m/s].
ROLLING = 2e-3


@project_style
def plot_hils(run: RunLog) -> Figure:
    """Draw a run; one with its carriage free has nothing simulated and is drawn as any other."""
    online = run.online
    if online is None or run.measured.z is None:
        return plot_run(run)
    figure = Figure(figsize=(STYLE.width, 11), layout="constrained")
    sinkage, error, zeta, slip, lateness = figure.subplots(
        5, 1, sharex=True, height_ratios=[2, 1, 1, 1, 1]
    )
    _sinkage(sinkage, run, online)
    _error(error, run, online)
    zeta.plot(online.time, online.zeta, **SIMULATED.line)
    zeta.set_ylabel("zeta [-]")
    _slip(slip, run)
    _lateness(lateness, online, count_ticks(run))
    lateness.set_xlabel("time [s]")
    early = run.end_reason is not None and run.end_reason != "completed"
    lines = [run.title, *([str(run.end_reason)] if early else []), *_findings(run)]
    title_above(figure, "\n".join(lines))
    return figure


def count_ticks(run: RunLog) -> TickCounts:
    """Count the ticks of a run in the loop, its missed deadlines and its missing readings."""
    online, events = run.online, run.events
    assert online is not None
    overruns = skips = skipped = 0
    if events is not None:
        overruns = int((events.code == Event.OVERRUN).sum())
        skips = int((events.code == Event.TICKS_SKIPPED).sum())
        skipped = int(events.arg[events.code == Event.TICKS_SKIPPED].sum())
    fresh = int(((online.flags & TickFlag.FRESH) != 0).sum())
    # Ticks that were skipped together are one overrun, but a deadline each.
    missed = overruns - skips + skipped
    return TickCounts(online.time.size, missed, skipped, online.time.size - fresh)


def _findings(run: RunLog) -> list[str]:
    """One line that names the safety rules that fired and the sensors that were stuck, if any."""
    if run.events is None:
        return []
    codes = dict.fromkeys(code for code in run.events.code.tolist() if code in FINDINGS)
    words = [run.events.meanings.get(code, str(code)).replace("_", " ") for code in codes]
    return [f"not all was well: {', '.join(words)}"] if words else []


def sinkage_error(run: RunLog) -> np.ndarray:
    """Measured minus simulated sinkage at the times of the readings [m]; empty without either."""
    return _timed_error(run)[1]


def _timed_error(run: RunLog) -> tuple[np.ndarray, np.ndarray]:
    """Times of the readings inside the loop's time [s], and simulated minus measured z then [m]."""
    online, z, within = run.online, run.measured.z, readings_in_the_loop(run)
    if online is None or z is None:
        return np.empty(0), np.empty(0)
    time = run.measured.time[within]
    return time, np.interp(time, online.time, online.z_sim) - z[within]


def readings_in_the_loop(run: RunLog) -> np.ndarray:
    """True for readings taken while the loop ticked, shape (readings,)."""
    time, online = run.measured.time, run.online
    if online is None:
        return np.zeros(time.shape, bool)
    return (time >= online.time[0]) & (time <= online.time[-1])


def _sinkage(axes: Axes, run: RunLog, online: Online) -> None:
    assert run.measured.z is not None
    scale = label_channel(axes, "z")
    axes.plot(run.measured.time, scale * run.measured.z, **REAL.line, label="HILS (real)")
    axes.plot(online.time, scale * online.z_sim, **SIMULATED.line, label="HILS (sim)")
    axes.legend()


def _error(axes: Axes, run: RunLog, online: Online) -> None:
    """Residual of the sinkage, and the tolerance inside which the tuner leaves zeta alone."""
    scale = label_difference(axes, "z", "sim - real")
    time, error = _timed_error(run)
    if online.tolerance:
        draw_floor(axes, scale * online.tolerance, "tolerance of the tuner")
    axes.plot(time, scale * error, **SIMULATED.line)
    said = f"RMSE {np.sqrt((error**2).mean()) * 1e3:.3f} mm" if error.size else ""
    if said or online.tolerance:
        axes.legend(title=said)


def commanded_slip(run: RunLog) -> np.ndarray | None:
    """Slip of the command [-], shape (commands,); NaN at rest, None where a number is missing."""
    command, radius = run.command, run.setup.wheel_radius
    if command.vx is None or radius is None:
        return None
    rolling = radius * command.omega
    slip = np.full(rolling.shape, math.nan)
    np.divide(command.vx, rolling, out=slip, where=np.abs(rolling) > ROLLING)
    return 1 - slip


def _slip(axes: Axes, run: RunLog) -> None:
    axes.set_ylabel("slip, commanded [-]")
    slip = commanded_slip(run)
    if slip is not None:  # what is not known leaves a gap in the line
        axes.plot(run.command.time, slip, **COMMANDED.line)


def _lateness(axes: Axes, online: Online, counts: TickCounts) -> None:
    axes.plot(online.time, online.age * 1e3, **COMMANDED.line, label="age of the reading")
    missed = online.late > 0
    axes.plot(
        online.time[missed],
        online.late[missed] * 1e3,
        "x",
        color=BEFORE.colour,
        label=f"over the deadline ({counts.missed} in {counts.ticks} ticks)",
    )
    unread = (online.flags & TickFlag.FRESH) == 0
    axes.plot(
        online.time[unread],
        np.zeros(int(unread.sum())),
        "|",
        color=AFTER.colour,
        label=f"without a reading ({counts.without_reading} of {counts.ticks} ticks)",
    )
    axes.set_ylim(bottom=0)
    axes.legend()
    axes.set_ylabel("lateness [ms]")
