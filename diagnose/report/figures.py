"""Figures of a report: the gap, weights, residuals of each run, and the disturbance."""

import base64
import io
import re
import warnings
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnose.localization.shares import GapShare
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import percent
from diagnose.unknown.correction_fit import UnknownEffect
from diagnose.unknown.dependence import PERIODIC_VARIABLE, signal_against
from drftjax.effects.correction import VARIABLES, Curve
from drftjax.recorded.observation import SHOWN

CHANNEL_NAMES = {
    "x": "travel x",
    "z": "height z",
    "fx": "force fx",
    "fz": "force fz",
    "torque": "torque",
}

BEFORE_COLOUR, AFTER_COLOUR, CORRECTION_COLOUR = "#b8542f", "#2a6f97", "#4c8c4a"
FLOOR_COLOUR = "0.55"

AXIS_COLOURS = {"phase": "#c9805f", "profile": "#8fae8b", "channel": "#8d99ae"}
"""Axes of the gap in the first figure; the report's table has the others."""


@dataclass(frozen=True)
class FigureSettings:
    """Sizes of the figures.

    Attributes:
        max_runs: Runs whose residuals are drawn at most.
        max_weights: Hypotheses whose weights are drawn at most.
        max_bins: Bins of an axis at most, the largest shares first.
        max_points: Points of a line, about at most: a line is a third of a page wide.
        columns: Panels of the disturbance side by side.
        min_opacity: Of dots whose standard error is large [-].
    """

    max_runs: int = 16
    max_weights: int = 8
    max_bins: int = 4
    max_points: int = 250
    columns: int = 3
    min_opacity: float = 0.08


DEFAULT_FIGURES = FigureSettings()


def at_a_glance(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of the gap before and after against the noise floor, and its main places."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
    _draw_gap(left, found)
    _draw_shares(right, found, settings.max_bins)
    return figure


def _draw_gap(axes: Axes, found: Diagnosis) -> None:
    """Bars of the gap by channel, before and after, in noise floors."""
    channels = list(found.gap)
    place = np.arange(len(channels))
    gaps = [found.gap[channel] for channel in channels]
    bars = [("reference model", BEFORE_COLOUR, [gap.before for gap in gaps])]
    if found.selected.effects:
        bars.append((*_model_label(found), [gap.after for gap in gaps]))
    wide = 0.4
    for number, (label, colour, left) in enumerate(bars):
        shifted = place + wide * (number - 0.5)
        sizes = [each / gap.floor for each, gap in zip(left, gaps, strict=True)]
        axes.barh(shifted, sizes, 0.9 * wide, color=colour, label=label)
        for at, size, each, channel in zip(shifted, sizes, left, channels, strict=True):
            unit, scale = SHOWN[channel]
            axes.text(size, at, f" {each * scale:.3g} {unit}", va="center", fontsize=8)
    axes.axvline(1, color=FLOOR_COLOUR, ls="--", lw=1.2, label="noise floor")
    axes.set_yticks(place, [CHANNEL_NAMES[channel] for channel in channels])
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.set_xlim(left=0)
    axes.set_xlabel("gap [noise floors]")
    axes.set_title("Simulated against recorded", fontsize=10, loc="left")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)


def _model_label(found: Diagnosis) -> tuple[str, str]:
    """Label and colour of the model with what is added."""
    if found.correction is not None:
        return "with the correction", CORRECTION_COLOUR
    return "with the effect", AFTER_COLOUR


def _draw_shares(axes: Axes, found: Diagnosis, max_bins: int) -> None:
    """Bars of the largest shares of the gap on each axis, with their intervals."""
    shares = [
        each
        for axis in AXIS_COLOURS
        for each in sorted(_shares_on(found, axis), key=lambda part: -part.share)[:max_bins]
    ]
    if not shares or all(gap.before <= gap.floor for gap in found.gap.values()):
        axes.set_axis_off()
        axes.text(
            0.5, 0.5, "no gap above the noise floor", ha="center", va="center", color=FLOOR_COLOUR
        )
        return
    place = range(len(shares))
    sizes = np.array([each.share for each in shares])
    spans = np.array([each.interval for each in shares]).T
    reach = np.abs(np.array([sizes - spans[0], spans[1] - sizes]))
    colours = [AXIS_COLOURS[each.axis] for each in shares]
    axes.barh(place, 100 * sizes, color=colours, xerr=100 * reach, ecolor="0.25", capsize=2)
    axes.set_yticks(place)
    axes.set_yticklabels([_label(each) for each in shares], fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 105)
    axes.set_xlabel("share of the gap [%]; each colour adds up to 100")
    axes.set_title("Where the gap lies", fontsize=10, loc="left")


def _shares_on(found: Diagnosis, axis: str) -> list[GapShare]:
    return [each for each in found.localization if each.axis == axis]


def _label(share: GapShare) -> str:
    return CHANNEL_NAMES.get(share.label, share.label) if share.axis == "channel" else share.label


def weights(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of the weights of the most probable hypotheses."""
    ranked = list(found.weights.items())[: settings.max_weights]
    figure = Figure(figsize=(6.4, 0.5 + 0.32 * len(ranked)), layout="constrained")
    axes = figure.subplots()
    place = range(len(ranked))
    colours = [AFTER_COLOUR if name in found.verdict else "0.75" for name, _ in ranked]
    axes.barh(place, [100 * weight for _, weight in ranked], color=colours)
    for at, (_, weight) in zip(place, ranked, strict=True):
        axes.text(100 * weight, at, f" {percent(weight)}", va="center", fontsize=8)
    axes.set_yticks(place)
    axes.set_yticklabels([name for name, _ in ranked], fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 115)
    axes.set_xlabel("weight [%]")
    return figure


def residuals(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of simulated minus recorded, one row for each run, one column for each channel."""
    dataset = found.dataset
    lines = [("reference model", BEFORE_COLOUR, found.residual_before)]
    if found.selected.effects:
        lines.append((*_model_label(found), found.selected.after))
    runs = range(min(len(dataset.runs), settings.max_runs))
    count = len(dataset.channels)
    figure = Figure(figsize=(4.8 * count, 1.25 * len(runs) + 0.7), layout="constrained")
    grid = figure.subplots(len(runs), count, squeeze=False, sharey="col")
    for run, row in zip(runs, grid, strict=True):
        name = dataset.runs[run].name
        for place, (channel, axes) in enumerate(zip(dataset.channels, row, strict=True)):
            unit, scale = SHOWN[channel]
            floor = found.floors[channel] * scale
            axes.axhspan(-floor, floor, color=FLOOR_COLOUR, alpha=0.25, lw=0, label="noise floor")
            time = dataset.time(run)
            for label, colour, values in lines:
                every = max(1, len(time) // settings.max_points)
                values_here = scale * values[run][place]
                axes.plot(time[::every], values_here[::every], color=colour, lw=0.9, label=label)
            axes.set_title(
                f"{name}, {CHANNEL_NAMES[channel]} [{unit}]", fontsize=8, parse_math=False
            )
            axes.tick_params(labelsize=7)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]", fontsize=8)
    grid[0][0].legend(fontsize=6, loc="best")
    return figure


def unknown_signal(
    found: Diagnosis, unknown: UnknownEffect, settings: FigureSettings = DEFAULT_FIGURES
) -> Figure:
    """Figure of the simplest disturbance against every variable that is known of the runs."""
    dataset, disturbance = found.dataset, unknown.disturbance
    shares = dict(unknown.dependence)
    panels = [
        (name, signal_against(dataset, disturbance, name)) for name in VARIABLES if name in shares
    ]
    columns = settings.columns
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(9.6, 2.5 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    spread = max(float(np.std(np.concatenate(disturbance.signal))), 1e-12)
    for axes, (name, pairs) in zip(grid, panels, strict=False):
        for run, (values, height) in enumerate(pairs):
            at = np.mod(values, 2 * np.pi) if name == PERIODIC_VARIABLE else values
            opacity = 1 - disturbance.error[run] / (2 * spread)
            axes.scatter(
                at,
                height,
                s=9,
                color=mpl.colormaps["viridis"](run / max(len(pairs) - 1, 1)),
                alpha=np.clip(opacity, settings.min_opacity, 0.9),
                linewidths=0,
            )
        if found.correction is not None and name == found.correction.effect.variable:
            _draw_curve(axes, found.correction.effect, pairs)
        axes.set_title(f"{name}: {shares[name]:.0%} of it", fontsize=9, loc="left")
        axes.set_xlabel(f"{name} [{VARIABLES[name]}]", fontsize=8)
        axes.tick_params(labelsize=7)
    for axes in grid[len(panels) :]:
        axes.remove()
    for axes in grid[::columns]:
        axes.set_ylabel(f"{disturbance.name} [{disturbance.unit}]", fontsize=8)
    return figure


def _draw_curve(axes: Axes, effect: Curve, pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    knots, height = np.asarray(effect.knots), np.asarray(effect.values())
    if effect.stage == "zeta":
        # A run's own zeta takes up any level; the dots' is drawn.
        around = 2 * np.pi if effect.variable == PERIODIC_VARIABLE else None
        miss = [h - np.interp(v, knots, height, period=around) for v, h in pairs]
        height = height + np.median(np.concatenate(miss))
    axes.plot(knots, height, color=CORRECTION_COLOUR, lw=2, label="correction")
    axes.legend(fontsize=7)


def as_source(figure: Figure) -> str:
    """The figure as a data URL of an SVG that refers to nothing, as the source of an <img>."""
    image = io.BytesIO()
    nothing: dict[str, None] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    # The same ids for the same figure: the same diagnosis makes the same page.
    with (
        mpl.rc_context({"svg.hashsalt": "drft", "svg.fonttype": "path"}),
        warnings.catch_warnings(),
    ):
        # A name may be in a script that the font lacks; it is drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(image, format="svg", metadata=nothing)
    text = re.sub(r"<!DOCTYPE.*?>", "", image.getvalue().decode(), flags=re.DOTALL)
    return "data:image/svg+xml;base64," + base64.b64encode(text.encode()).decode()
