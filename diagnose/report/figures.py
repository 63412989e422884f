"""The figures of a report: the gap at a glance, weights, and residuals of each run."""

import base64
import io
import re
import warnings

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnose.localization.shares import GapShare
from diagnose.result import Diagnosis
from diagnose.selection.model_weights import percent
from diagnose.unknown.correction_fit import UnknownEffect
from diagnose.unknown.dependence import signal_against
from drftjax.effects.correction import VARIABLES, Curve
from drftjax.recorded.observation import SHOWN

NAMES = {"x": "travel x", "z": "height z", "fx": "force fx", "fz": "force fz", "torque": "torque"}


BEFORE, AFTER, CORRECTED, FLOOR = "#b8542f", "#2a6f97", "#4c8c4a", "0.55"


# What the gap is cut by at a glance; the report's table has the other axes.
CUTS = {"phase": "#c9805f", "profile": "#8fae8b", "channel": "#8d99ae"}


# So many runs are drawn, so many weights, bins of an axis and points of a line.
MOST_RUNS, MOST_WEIGHTS, MOST_BINS, MOST_POINTS = 16, 8, 4, 600


# Panels of the unknown signal stand in so many columns; dots of large error are this faint.
COLUMNS, FAINTEST = 3, 0.08


def at_a_glance(found: Diagnosis) -> Figure:
    """The gap before and after against the noise floor, and where it lies."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.1))
    _before_and_after(left, found)
    _bins(right, found)
    return figure


def _before_and_after(axes: Axes, found: Diagnosis) -> None:
    channels = list(found.gap)
    place = np.arange(len(channels))
    gaps = [found.gap[channel] for channel in channels]
    bars = [("reference model", BEFORE, [gap.before for gap in gaps])]
    if found.selected.effects:
        bars.append((*_with_what(found), [gap.after for gap in gaps]))
    wide = 0.4
    for number, (label, colour, left) in enumerate(bars):
        shifted = place + wide * (number - 0.5)
        sizes = [each / gap.floor for each, gap in zip(left, gaps, strict=True)]
        axes.barh(shifted, sizes, 0.9 * wide, color=colour, label=label)
        for at, size, each, channel in zip(shifted, sizes, left, channels, strict=True):
            unit, scale = SHOWN[channel]
            axes.text(size, at, f" {each * scale:.3g} {unit}", va="center", fontsize=8)
    axes.axvline(1, color=FLOOR, ls="--", lw=1.2, label="noise floor")
    axes.set_yticks(place, [NAMES[channel] for channel in channels])
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.set_xlim(left=0)
    axes.set_xlabel("gap [noise floors]")
    axes.set_title("Simulated against recorded", fontsize=10, loc="left")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)


def _with_what(found: Diagnosis) -> tuple[str, str]:
    """What is added, in words, and its colour."""
    if found.correction is not None:
        return "with the correction", CORRECTED
    return "with the effect", AFTER


def _bins(axes: Axes, found: Diagnosis) -> None:
    shares = [
        each
        for axis in CUTS
        for each in sorted(_of(found, axis), key=lambda part: -part.share)[:MOST_BINS]
    ]
    if not shares or all(gap.before <= gap.floor for gap in found.gap.values()):
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no gap above the noise floor", ha="center", va="center", color=FLOOR)
        return
    place = range(len(shares))
    sizes = np.array([each.share for each in shares])
    spans = np.array([each.interval for each in shares]).T
    reach = np.abs(np.array([sizes - spans[0], spans[1] - sizes]))
    colours = [CUTS[each.axis] for each in shares]
    axes.barh(place, 100 * sizes, color=colours, xerr=100 * reach, ecolor="0.25", capsize=2)
    axes.set_yticks(place)
    axes.set_yticklabels([_label(each) for each in shares], fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 105)
    axes.set_xlabel("share of the gap [%]; each colour adds up to 100")
    axes.set_title("Where the gap lies", fontsize=10, loc="left")


def _of(found: Diagnosis, axis: str) -> list[GapShare]:
    return [each for each in found.localization if each.axis == axis]


def _label(share: GapShare) -> str:
    return NAMES.get(share.label, share.label) if share.axis == "channel" else share.label


def weights(found: Diagnosis) -> Figure:
    """The likeliest explanations."""
    ranked = list(found.weights.items())[:MOST_WEIGHTS]
    figure = Figure(figsize=(6.4, 0.5 + 0.32 * len(ranked)), layout="constrained")
    axes = figure.subplots()
    place = range(len(ranked))
    colours = [AFTER if name in found.verdict else "0.75" for name, _ in ranked]
    axes.barh(place, [100 * weight for _, weight in ranked], color=colours)
    for at, (_, weight) in zip(place, ranked, strict=True):
        axes.text(100 * weight, at, f" {percent(weight)}", va="center", fontsize=8)
    axes.set_yticks(place)
    axes.set_yticklabels([name for name, _ in ranked], fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0, 115)
    axes.set_xlabel("weight [%]")
    return figure


def residuals(found: Diagnosis) -> Figure:
    """Simulated less recorded, one row for each run, one column for each channel."""
    case = found.dataset
    lines = [("reference model", BEFORE, found.residual_before)]
    if found.selected.effects:
        lines.append((*_with_what(found), found.selected.after))
    runs = range(min(len(case.runs), MOST_RUNS))
    count = len(case.channels)
    figure = Figure(figsize=(4.8 * count, 1.25 * len(runs) + 0.7), layout="constrained")
    grid = figure.subplots(len(runs), count, squeeze=False, sharey="col")
    for run, row in zip(runs, grid, strict=True):
        name = case.runs[run].name
        for place, (channel, axes) in enumerate(zip(case.channels, row, strict=True)):
            unit, scale = SHOWN[channel]
            floor = found.floors[channel] * scale
            axes.axhspan(-floor, floor, color=FLOOR, alpha=0.25, lw=0, label="noise floor")
            time = case.time(run)
            for label, colour, values in lines:
                _line(axes, time, scale * values[run][place], colour, label)
            axes.set_title(f"{name}, {NAMES[channel]} [{unit}]", fontsize=8, parse_math=False)
            axes.tick_params(labelsize=7)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]", fontsize=8)
    grid[0][0].legend(fontsize=6, loc="best")
    return figure


def unknown_signal(found: Diagnosis, signal: UnknownEffect) -> Figure:
    """The simplest unknown signal against every variable that the runs tell."""
    case, stage = found.dataset, signal.stage
    shares = dict(signal.follows)
    panels = [(name, signal_against(case, stage, name)) for name in VARIABLES if name in shares]
    lines = -(-len(panels) // COLUMNS)
    figure = Figure(figsize=(9.6, 2.5 * lines), layout="constrained")
    grid = figure.subplots(lines, COLUMNS, sharey=True, squeeze=False).ravel()
    spread = max(float(np.std(np.concatenate(stage.signal))), 1e-12)
    for axes, (name, pairs) in zip(grid, panels, strict=False):
        for run, (values, height) in enumerate(pairs):
            at = np.mod(values, 2 * np.pi) if name == "wheel angle" else values
            sure = np.clip(1 - stage.error[run] / (2 * spread), FAINTEST, 0.9)
            colour = mpl.colormaps["viridis"](run / max(len(pairs) - 1, 1))
            axes.scatter(at, height, s=9, color=colour, alpha=sure, linewidths=0)
        if found.correction is not None and name == found.correction.effect.variable:
            _curve(axes, found.correction.effect, pairs)
        axes.set_title(f"{name}: {shares[name]:.0%} of it", fontsize=9, loc="left")
        axes.set_xlabel(f"{name} [{VARIABLES[name]}]", fontsize=8)
        axes.tick_params(labelsize=7)
    for axes in grid[len(panels) :]:
        axes.remove()
    for axes in grid[::COLUMNS]:
        axes.set_ylabel(f"{stage.name} [{stage.unit}]", fontsize=8)
    return figure


def _curve(axes: Axes, effect: Curve, pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    knots, height = np.asarray(effect.knots), np.asarray(effect.values())
    if effect.stage == "zeta":
        # A run's own zeta takes up any level; the dots' is drawn.
        around = 2 * np.pi if effect.variable == "wheel angle" else None
        miss = [h - np.interp(v, knots, height, period=around) for v, h in pairs]
        height = height + np.median(np.concatenate(miss))
    axes.plot(knots, height, color=CORRECTED, lw=2, label="correction")
    axes.legend(fontsize=7)


def _line(axes: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str) -> None:
    every = max(1, len(time) // MOST_POINTS)
    axes.plot(time[::every], values[::every], color=colour, lw=0.9, label=label)


def as_source(figure: Figure) -> str:
    """The figure as what an <img> shows without any file: SVG that refers to nothing."""
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
