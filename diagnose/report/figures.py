"""Figures of a report: the gap, weights, residuals of each run, and the disturbance."""

import base64
import io
import re
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnose.localization.shares import GapShare
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import percent
from diagnose.unknown.correction_fit import UnknownEffect
from diagnose.unknown.dependence import PERIODIC_VARIABLE, signal_against
from drftjax.common.figures import (
    AFTER,
    BEFORE,
    FAINT,
    FLOOR_COLOUR,
    PARTS,
    STYLE,
    LineRole,
    boxes_for_letters,
    draw_floor,
    label_difference,
    legend_below,
    panel_rows,
    project_style,
)
from drftjax.effects.correction import VARIABLES, Curve
from drftjax.recorded.observation import SHOWN

CHANNEL_NAMES = {
    "x": "travel x",
    "z": "height z",
    "fx": "force fx",
    "fz": "force fz",
    "torque": "torque",
}

AXIS_COLOURS = {"phase": PARTS[1], "profile": PARTS[2], "channel": PARTS[4]}
"""Axes of the gap in the first figure; the report's table has the others."""


@dataclass(frozen=True)
class FigureSettings:
    """Sizes of the figures.

    Attributes:
        max_runs: Runs whose residuals are drawn at most.
        max_weights: Hypotheses whose weights are drawn at most.
        max_bins: Bins of an axis at most, the largest shares first.
        max_points: Points of a line, about at most: a line is a third of a page wide.
        min_opacity: Of dots whose standard error is large [-].
    """

    max_runs: int = 16
    max_weights: int = 8
    max_bins: int = 4
    max_points: int = 250
    min_opacity: float = 0.08


DEFAULT_FIGURES = FigureSettings()


@project_style
def at_a_glance(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of the gap before and after against the noise floor, and its main places."""
    shares = _largest_shares(found, settings.max_bins)
    heights = (1.5 + 0.6 * len(found.gap), 0.9 + 0.3 * max(len(shares), 2))
    figure = Figure(figsize=(STYLE.width, sum(heights)), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=heights)
    _draw_gap(above, found)
    _draw_shares(below, shares)
    return figure


def _draw_gap(axes: Axes, found: Diagnosis) -> None:
    """Bars of the gap by channel, before and after, in noise floors."""
    channels = list(found.gap)
    place = np.arange(len(channels))
    gaps = [found.gap[channel] for channel in channels]
    bars = [("reference model", BEFORE, "//", [gap.before for gap in gaps])]
    if found.selected.effects:
        bars.append((_model_label(found), AFTER, "", [gap.after for gap in gaps]))
    wide = 0.4
    for number, (label, role, hatch, sizes) in enumerate(bars):
        shifted = place + wide * (number - 0.5)
        floors = [each / gap.floor for each, gap in zip(sizes, gaps, strict=True)]
        axes.barh(
            shifted, floors, 0.9 * wide, color=role.colour, hatch=hatch, ec="white", label=label
        )
        for at, size, each, channel in zip(shifted, floors, sizes, channels, strict=True):
            unit, scale = SHOWN[channel]
            axes.text(size, at, f" {each * scale:.3g} {unit}", va="center")
    axes.axvspan(0, 1, color=FLOOR_COLOUR, alpha=0.25, lw=0, zorder=0, label="noise floor")
    axes.set_yticks(place, [CHANNEL_NAMES[channel] for channel in channels])
    axes.margins(x=0.25)
    axes.set_xlim(left=0)
    axes.set_xlabel("gap [noise floors]")
    axes.set_title("Simulated against recorded", loc="left")
    # The legend has a row of its own above the bars.
    axes.set_ylim(len(channels) - 0.5, -1.2)
    axes.legend(loc="upper right", ncols=3, frameon=False)


def _model_label(found: Diagnosis) -> str:
    """Words for the model with what is added."""
    return "with the effect" if found.correction is None else "with the correction"


def _largest_shares(found: Diagnosis, max_bins: int) -> list[GapShare]:
    """The largest shares on each axis; none where no gap is above the noise floor."""
    if all(gap.before <= gap.floor for gap in found.gap.values()):
        return []
    return [
        each
        for axis in AXIS_COLOURS
        for each in sorted(_shares_on(found, axis), key=lambda part: -part.share)[:max_bins]
    ]


def _draw_shares(axes: Axes, shares: list[GapShare]) -> None:
    """Bars of the largest shares of the gap on each axis, with their intervals."""
    if not shares:
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
    axes.set_yticklabels([_label(each) for each in shares], parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 105)
    axes.set_xlabel("share of the gap [%]; each colour adds up to 100")
    axes.set_title("Where the gap lies", loc="left")


def _shares_on(found: Diagnosis, axis: str) -> list[GapShare]:
    return [each for each in found.localization if each.axis == axis]


def _label(share: GapShare) -> str:
    return CHANNEL_NAMES.get(share.label, share.label) if share.axis == "channel" else share.label


@project_style
def weights(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of the weights of the most probable hypotheses."""
    ranked = list(found.weights.items())[: settings.max_weights]
    figure = Figure(figsize=(STYLE.width, 0.7 + 0.32 * len(ranked)), layout="constrained")
    axes = figure.subplots()
    place = range(len(ranked))
    colours = [AFTER.colour if name in found.verdict else FAINT for name, _ in ranked]
    axes.barh(place, [100 * weight for _, weight in ranked], color=colours)
    for at, (_, weight) in zip(place, ranked, strict=True):
        axes.text(100 * weight, at, f" {percent(weight)}", va="center")
    axes.set_yticks(place)
    axes.set_yticklabels([name for name, _ in ranked], parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 115)
    axes.set_xlabel("weight [%]")
    return figure


@project_style
def residuals(found: Diagnosis, settings: FigureSettings = DEFAULT_FIGURES) -> Figure:
    """Figure of simulated minus recorded of each run, by channel, in two columns."""
    dataset = found.dataset
    lines: list[tuple[str, LineRole, list[np.ndarray]]] = [
        ("reference model", BEFORE, found.residual_before)
    ]
    if found.selected.effects:
        lines.append((_model_label(found), AFTER, found.selected.after))
    runs = range(min(len(dataset.runs), settings.max_runs))
    places = [(run, place) for run in runs for place in range(len(dataset.channels))]
    figure, panels = panel_rows(len(places), 1.9)
    first: dict[str, Axes] = {}
    for (run, place), axes in zip(places, panels, strict=True):
        channel = dataset.channels[place]
        scale = label_difference(axes, channel, "residual")
        draw_floor(axes, found.floors[channel] * scale)
        time = dataset.logged_time(run)
        every = max(1, len(time) // settings.max_points)
        for label, role, values in lines:
            shown = scale * values[run][place][::every]
            axes.plot(time[::every], shown, **role.line, label=label)
        axes.set_title(f"{dataset.runs[run].name}, {CHANNEL_NAMES[channel]}", parse_math=False)
        if first.setdefault(channel, axes) is not axes:
            axes.sharey(first[channel])
        axes.set_xlabel("time [s]")
    legend_below(figure, panels)
    return figure


@project_style
def unknown_signal(
    found: Diagnosis, unknown: UnknownEffect, settings: FigureSettings = DEFAULT_FIGURES
) -> Figure:
    """Figure of the simplest disturbance against every variable that is known of the runs."""
    dataset, disturbance = found.dataset, unknown.disturbance
    shares = dict(unknown.dependence)
    known = [
        (name, signal_against(dataset, disturbance, name)) for name in VARIABLES if name in shares
    ]
    figure, panels = panel_rows(len(known), 2.5)
    spread = max(float(np.std(np.concatenate(disturbance.signal))), 1e-12)
    for axes, (name, pairs) in zip(panels, known, strict=True):
        for run, (values, height) in enumerate(pairs):
            at = np.mod(values, 2 * np.pi) if name == PERIODIC_VARIABLE else values
            opacity: Any = 1 - disturbance.error[run] / (2 * spread)
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
        if axes is not panels[0]:
            axes.sharey(panels[0])
        axes.set_title(f"{name}: {shares[name]:.0%} of it", loc="left")
        axes.set_xlabel(f"{name} [{VARIABLES[name]}]")
    for axes in panels[:: STYLE.columns]:
        axes.set_ylabel(f"{disturbance.name} [{disturbance.unit}]")
    return figure


def _draw_curve(axes: Axes, effect: Curve, pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    knots, height = np.asarray(effect.knots), np.asarray(effect.values())
    if effect.stage == "zeta":
        # A run's own zeta takes up any level; the dots' is drawn.
        around = 2 * np.pi if effect.variable == PERIODIC_VARIABLE else None
        miss = [h - np.interp(v, knots, height, period=around) for v, h in pairs]
        height = height + np.median(np.concatenate(miss))
    axes.plot(knots, height, color=AFTER.colour, lw=2.2, label="correction")
    axes.legend()


def as_source(figure: Figure) -> str:
    """The figure as a data URL of an SVG that refers to nothing, as the source of an <img>."""
    image = io.BytesIO()
    nothing: dict[str, None] = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    # The same ids for the same figure: the same diagnosis makes the same page.
    with mpl.rc_context({"svg.hashsalt": "drft", "svg.fonttype": "path"}), boxes_for_letters():
        figure.savefig(image, format="svg", metadata=nothing)
    text = re.sub(r"<!DOCTYPE.*?>", "", image.getvalue().decode(), flags=re.DOTALL)
    return "data:image/svg+xml;base64," + base64.b64encode(text.encode()).decode()
