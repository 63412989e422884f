"""Figures of a designed run, and of a screening of numbers."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.figures import (
    AFTER,
    BEFORE,
    FAINT,
    FLOOR_COLOUR,
    STYLE,
    TRUE,
    legend_below,
    project_style,
    title_above,
)
from identify.design.design import Design
from identify.design.screening import GlobalSensitivity
from identify.design.screening_report import noise_text, range_text

# Smallest change in the figure, in noise: a hundred times less than can be seen of one reading.
SMALLEST_SHOWN = 1e-2


@project_style
def plot_design(result: Design) -> Figure:
    """Plot the given and the best profile, and the standard error over peak speeds."""
    figure = Figure(figsize=(STYLE.width, 7), layout="constrained")
    profile, scan = figure.subplots(2, 1)
    for each, name, role in ((result.given, "given", BEFORE), (result.best, "best", AFTER)):
        command = each.setup.command.build()
        label = f"{name}: ±{each.information.error:.2g}"
        profile.plot(command.time, np.degrees(command.omega), **role.line, marker=".", label=label)
    profile.set_xlabel("time [s]")
    profile.set_ylabel("wheel speed [deg/s]")
    profile.legend(title=f"standard error of {result.parameter}")
    peaks = np.degrees(result.peaks)
    errors = np.array([each.information.error for each in result.scan])
    shifts = np.array([result.shift(each) for each in result.scan])
    scan.loglog(peaks, errors, **AFTER.line, marker="o", label="standard error, white noise")
    label = f"shift by a model error of {result.model_error * 1e3:.3g} mm"
    scan.loglog(peaks, shifts, **TRUE.line, marker="s", label=label)
    value = abs(result.given.information.value)
    if value:
        label = f"{result.wanted:.0%} of the value"
        scan.axhline(result.wanted * value, color=FLOOR_COLOUR, lw=1, ls="-.", label=label)
    scan.set_xticks(peaks, [f"{each:.0f}" for each in peaks])
    scan.minorticks_off()
    scan.set_xlabel("peak speed of a trapezoid [deg/s]")
    scan.set_ylabel(f"error of {result.parameter} [{result.unit}]")
    scan.legend()
    return figure


@project_style
def plot_screening(result: GlobalSensitivity) -> Figure:
    """Plot the change that each number makes, in noise, a panel for each channel."""
    count, channels = len(result.ranges), len(result.channels)
    # Beside the names, each channel needs room for its decades.
    width = max(STYLE.width, 3.4 + 1.8 * channels)
    figure = Figure(figsize=(width, 2.2 + 0.21 * count), layout="constrained")
    panels = figure.subplots(1, channels, sharey=True, squeeze=False)[0]
    for place, (axes, channel) in enumerate(zip(panels, result.channels, strict=True)):
        _draw_channel(axes, result, place)
        axes.set_xlabel("change, in noise [-]")
        axes.set_title(f"{channel}: noise\n{noise_text(result, channel)}")
    first = panels[0]
    names = [
        f"{each.quantity.label}   {range_text(each)}"
        for each in (result.ranges[index] for index in result.order)
    ]
    first.set_yticks(range(count), names)
    first.set_ylim(count - 0.4, -0.6)
    legend_below(figure, [first], columns=2)
    title_above(figure, f"{result.title}: which numbers can matter")
    return figure


def _draw_channel(axes: Axes, result: GlobalSensitivity, place: int) -> None:
    order = result.order
    effects = result.effects
    size, interval, spread = (
        np.nan_to_num(each[order, place])
        for each in (effects.mean_size, effects.interval, effects.spread)
    )
    rows = np.arange(len(order))
    axes.set_xscale("log")
    matters = size + interval >= 1
    for chosen, colour, name in (
        (matters, AFTER.colour, "mean change that reaches the noise"),
        (~matters, FAINT, "mean change below the noise"),
    ):
        width = np.maximum(size - SMALLEST_SHOWN, 0)[chosen]
        axes.barh(rows[chosen], width, left=SMALLEST_SHOWN, color=colour, height=0.7, label=name)
    seen = size + interval > SMALLEST_SHOWN
    low = np.minimum(interval, np.maximum(size - SMALLEST_SHOWN, 0))
    axes.errorbar(
        size[seen],
        rows[seen],
        xerr=[low[seen], interval[seen]],
        fmt="none",
        ecolor="0.2",
        elinewidth=0.8,
        label="95 % interval",
    )
    some = spread > SMALLEST_SHOWN
    label = "spread by the other numbers"
    axes.plot(spread[some], rows[some], "o", mfc="none", mec=BEFORE.colour, ms=3, label=label)
    axes.axvline(1, color=FLOOR_COLOUR, lw=1.5, ls="--", label="noise of one reading")
    most = max(10.0, float((size + interval).max(initial=0)), float(spread.max(initial=0)))
    axes.set_xlim(SMALLEST_SHOWN, 2 * most)
    axes.grid(axis="y", visible=False)
