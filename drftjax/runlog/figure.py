"""Time plots of one run: commands above, measurements below, on one time axis."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.common.figures import (
    COMMANDED,
    RECORDED,
    SIMULATED,
    STYLE,
    LineRole,
    label_channel,
    project_style,
    title_above,
)
from drftjax.runlog.record import RunLog
from drftjax.runlog.schema import UNITS

LARGEST_DRAWN: Final = 1e30
"""Largest number that is drawn: no rig has more in any unit, and axes overflow near 1e308."""

Curve = tuple[str, LineRole, np.ndarray, np.ndarray]
"""Label, role, times [s] and values."""


@project_style
def plot_run(run: RunLog) -> Figure:
    """Draw every channel of a run, in a figure without a window.

    Raises:
        InputError: names a channel whose numbers are too large for an axis.
    """
    _require_drawable(run)
    panels = [*_commands(run), *_channels(run)]
    figure = Figure(figsize=(STYLE.width, 1 + 1.7 * len(panels)), layout="constrained")
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for (name, curves), axes in zip(panels, grid, strict=True):
        _draw(axes, name, curves)
    grid[-1].set_xlabel("time [s]")
    title_above(figure, run.title)
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


def _commands(run: RunLog) -> Iterator[tuple[str, list[Curve]]]:
    """Commanded wheel speed, and carriage speed where it is driven: axis and curve of each."""
    command = run.command
    measured, degrees = run.measured.omega, 180 / math.pi
    speeds: list[Curve] = [("commanded", COMMANDED, command.time, degrees * command.omega)]
    if measured is not None:
        speeds.insert(0, ("measured", RECORDED, run.measured.time, degrees * measured))
    yield "wheel speed [deg/s]", speeds
    if command.vx is not None:
        yield (
            "carriage [mm/s]",
            [("commanded", COMMANDED, command.time, 1e3 * command.vx)],
        )


def _channels(run: RunLog) -> Iterator[tuple[str, list[Curve]]]:
    """Measured channels, each with what the loop simulated of it, and the loop's zeta."""
    online = run.online
    for name, values in run.measured.channels().items():
        curves: list[Curve] = [("measured", RECORDED, run.measured.time, values)]
        simulated = getattr(online, f"{name}_sim", None)
        if online is not None and simulated is not None:
            curves.append(("simulated online", SIMULATED, online.time, simulated))
        yield name, curves
    if online is not None:
        yield "online zeta [-]", [("tuned", SIMULATED, online.time, online.zeta)]


def _draw(axes: Axes, name: str, curves: list[Curve]) -> None:
    """Draw one panel: a channel by its name, or another quantity by the label of its axis."""
    if name.endswith("]"):
        axes.set_ylabel(name)
        scale = 1.0
    else:
        scale = label_channel(axes, name)
    for label, role, time, values in curves:
        # A single row, such as a steady mean, is a dot.
        marker = "o" if time.size == 1 else None
        axes.plot(time, scale * values, **role.line, marker=marker, label=label)
    if len(curves) > 1:
        axes.legend()
