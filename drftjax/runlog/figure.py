"""Time plots of one run: commands above, measurements below, on one time axis."""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.runlog.record import RunLog
from drftjax.runlog.schema import UNITS

LARGEST_DRAWN: Final = 1e30
"""Largest number that is drawn: no rig has more in any unit, and axes overflow near 1e308."""

Panel = Callable[[Axes, RunLog], None]


def plot_run(run: RunLog) -> Figure:
    """Draw every channel of a run, in a figure without a window.

    Raises:
        InputError: names a channel whose numbers are too large for an axis.
    """
    _require_drawable(run)
    panels = list(_panels(run))
    figure = Figure(figsize=(8, 1 + 1.7 * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for panel, each in zip(panels, axes, strict=True):
        panel(each, run)
        each.grid(alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    # A title is any text: a dollar sign in it is no formula.
    figure.suptitle(run.title.replace("$", r"\$"), fontsize="medium")
    return figure


def _require_drawable(run: RunLog) -> None:
    """Refuse a run with numbers that overflow an axis."""
    for title in ("command", "measured", "online"):
        part = getattr(run, title)
        for name, unit in UNITS[title].items():
            values = getattr(part, name, None)
            largest = 0.0 if values is None else float(np.abs(values).max())
            if largest > LARGEST_DRAWN:
                raise InputError(f"/{title}/{name} reaches {largest:g} {unit}, too large to draw")


def _panels(run: RunLog) -> list[Panel]:
    """Panels for the channels that the run has, from top to bottom."""
    measured, panels = run.measured, [_command]
    if measured.z is not None:
        panels.append(_height)
    if measured.x is not None:
        panels.append(_travel)
    if measured.fx is not None or measured.fz is not None:
        panels.append(_forces)
    if measured.torque is not None:
        panels.append(_torque)
    if run.online is not None:
        panels.append(_scaling)
    return panels


def _command(axes: Axes, run: RunLog) -> None:
    """Commanded wheel speed, and carriage speed where it is driven."""
    command = run.command
    axes.plot(command.time, command.omega * (180 / math.pi), color="C0")
    axes.set_ylabel("omega [deg/s]")
    if command.vx is not None:
        other = axes.twinx()
        other.plot(command.time, command.vx * 1e3, color="C1", linestyle="--")
        other.set_ylabel("carriage [mm/s]", color="C1")


def _height(axes: Axes, run: RunLog) -> None:
    """Height of the wheel, measured and simulated online."""
    _channel(axes, run, run.measured.z, "measured", 1e3)
    if run.online is not None:
        axes.plot(run.online.time, run.online.z_sim * 1e3, color="C1", label="simulated online")
        axes.legend(fontsize="small")
    axes.set_ylabel("z [mm]")


def _travel(axes: Axes, run: RunLog) -> None:
    """Travel, measured and simulated online."""
    _channel(axes, run, run.measured.x, "measured", 1.0)
    if run.online is not None:
        axes.plot(run.online.time, run.online.x_sim, color="C1", label="simulated online")
        axes.legend(fontsize="small")
    axes.set_ylabel("x [m]")


def _forces(axes: Axes, run: RunLog) -> None:
    """Measured forces."""
    for name, values in (("fx", run.measured.fx), ("fz", run.measured.fz)):
        if values is not None:
            _channel(axes, run, values, name, 1.0, color=None)
    axes.legend(fontsize="small")
    axes.set_ylabel("force [N]")


def _torque(axes: Axes, run: RunLog) -> None:
    """Measured torque."""
    _channel(axes, run, run.measured.torque, "measured", 1.0)
    axes.set_ylabel("torque [N m]")


def _scaling(axes: Axes, run: RunLog) -> None:
    """zeta of the control loop."""
    assert run.online is not None
    axes.plot(run.online.time, run.online.zeta, color="C1")
    axes.set_ylabel("online zeta [-]")


def _channel(
    axes: Axes, run: RunLog, values: Any, label: str, scale: float, color: str | None = "C0"
) -> None:
    """Draw a channel as a line; a single row, such as a steady mean, as a dot."""
    time = run.measured.time
    marker = "o" if time.size == 1 else None
    axes.plot(time, values * scale, color=color, marker=marker, label=label)
