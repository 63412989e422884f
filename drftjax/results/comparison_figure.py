"""Recorded channels beside simulated ones, each above its residual and the noise floor.

A residual is simulated less recorded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.figures import (
    AFTER,
    BEFORE,
    RECORDED,
    STYLE,
    draw_floor,
    label_channel,
    label_difference,
    legend_below,
    project_style,
    title_above,
)

FEW_SAMPLES = 5
"""Samples below which a line has marks too: a steady mean is a single one."""


@dataclass(frozen=True, eq=False)
class ComparedChannel:
    """One channel of one run, recorded and simulated.

    Attributes:
        title: Of its panels.
        channel: One of x, z, fx, fz, torque.
        time: Times [s], shape (samples,).
        recorded: Recorded values [m, N, N m], shape (samples,).
        simulated: Values "before" and "after", likewise, by the words of the legend.
        floor: Noise floor [m, N, N m]; None where it is not known.
        band: Lower and upper end of expected readings, likewise; None where none are known.
    """

    title: str
    channel: str
    time: np.ndarray
    recorded: np.ndarray
    simulated: Mapping[str, np.ndarray] = field(default_factory=dict)
    floor: float | None = None
    band: tuple[np.ndarray, np.ndarray] | None = None


@project_style
def comparison_figure(compared: Sequence[ComparedChannel], title: str) -> Figure:
    """Figure of recorded and simulated channels, and below each its residual.

    Args:
        compared: Channels, in two columns. Of `simulated` the first is drawn as the reference
            model's, the second as that with what was added or fitted.
        title: Of the figure.
    """
    columns = min(STYLE.columns, len(compared))
    rows = -(-len(compared) // columns)
    figure = Figure(figsize=(STYLE.width, 0.9 + 3.7 * rows), layout="constrained")
    grid = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=(5, 3) * rows)
    for place, each in enumerate(compared):
        row, column = divmod(place, columns)
        above, below = grid[2 * row : 2 * row + 2, column]
        above.sharex(below)
        above.tick_params(labelbottom=False)
        _draw_values(above, each)
        _draw_residuals(below, each)
    for place in range(len(compared), rows * columns):
        row, column = divmod(place, columns)
        for spare in grid[2 * row : 2 * row + 2, column]:
            spare.remove()
    legend_below(figure, figure.axes)
    title_above(figure, title)
    return figure


def _roles(each: ComparedChannel):
    return zip(each.simulated.items(), (BEFORE, AFTER), strict=False)


def _draw_values(axes: Axes, each: ComparedChannel) -> None:
    scale = label_channel(axes, each.channel)
    marker = "." if len(each.time) < FEW_SAMPLES else None
    if each.band is not None:
        low, high = (scale * edge for edge in each.band)
        label = "90 % of readings"
        axes.fill_between(each.time, low, high, color=AFTER.colour, alpha=0.25, lw=0, label=label)
    axes.plot(each.time, scale * each.recorded, **RECORDED.line, marker=marker, label="recorded")
    for (label, values), role in _roles(each):
        axes.plot(each.time, scale * values, **role.line, marker=marker, label=label)
    axes.set_title(each.title, parse_math=False, wrap=True)


def _draw_residuals(axes: Axes, each: ComparedChannel) -> None:
    scale = label_difference(axes, each.channel, "residual")
    marker = "." if len(each.time) < FEW_SAMPLES else None
    if each.floor is not None:
        draw_floor(axes, scale * each.floor)
    for (label, values), role in _roles(each):
        residual = scale * (values - each.recorded)
        axes.plot(each.time, residual, **role.line, marker=marker, label=label)
    axes.set_xlabel("time [s]")
