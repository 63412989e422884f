"""Figures of the change that effects make to the run of Fuke, Ishikawa & Ishigami 2024."""

import textwrap
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.errors import InputError
from drftjax.common.figures import (
    AFTER,
    BEFORE,
    FAINT,
    HATCHES,
    PARTS,
    STYLE,
    label_channel,
    label_difference,
    legend_below,
    project_style,
    title_above,
)
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata
from drftjax.effects.listing import typical_sizes
from drftjax.effects.serialization import typical_effect
from drftjax.physics.command import command_at
from drftjax.physics.state import Output, State
from drftjax.simulation.rollout import simulate, step_times
from drftjax.simulation.simulator import Simulator

# The paper's profile: knots in time [s] and wheel speed [deg/s], from this sinkage [m].
TIME, SPEED, SINKAGE = (0.0, 2.0, 7.0, 17.0, 22.0, 24.0), (0.0, 0.0, 30.0, 30.0, 0.0, 0.0), 0.0176


STEP, EVERY = 2e-3, 25


Classes = list[type[AbstractEffect]]


COMMON_SCALE = (1e-2, 1e2)
"""Ends of the gallery's axis of sizes [mm]: half a rig's noise of z, a tenth of the travel."""


LETTERS = 44
"""Of a line of text above a pair of panels."""


def simulate_effects(effects: Classes) -> Output:
    """Simulate the paper's run without effects, then with each at its typical size.

    One compiled program makes them all, as an absent effect is one of zero strength.

    Args:
        effects: Classes of effects.

    Returns:
        Outputs of shape (1 + effects, rows).
    """
    fields = [(index, name) for index, each in enumerate(effects) for name in field_metadata(each)]
    null = [float(getattr(effects[index](), name)) for index, name in fields]
    table = [null]
    for one, effect in enumerate(effects):
        sized = typical_effect(effect)
        table.append(
            [float(getattr(sized, name)) if index == one else at_null for (index, name), at_null in
             zip(fields, null, strict=True)]
        )  # fmt: skip
    commands = command_at(
        step_times(round(TIME[-1] / STEP), STEP), jnp.asarray(TIME), jnp.radians(jnp.asarray(SPEED))
    )

    def run(values) -> Output:
        given: list[dict] = [{} for _ in effects]
        for (index, name), value in zip(fields, values, strict=True):
            given[index][name] = value
        built = tuple(each(**those) for each, those in zip(effects, given, strict=True))
        simulator = replace(Simulator(), effects=built)
        return simulate(simulator, State.at_rest(SINKAGE), commands, STEP, every=EVERY)[1]

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(jnp.asarray(table)))


@project_style
def draw_effect(effect: type[AbstractEffect]) -> Figure:
    """Draw the sinkage with and without an effect, and the changes that it makes in z and x.

    Of an effect that shows in other channels alone, these are drawn.

    Raises:
        InputError: for an effect that the paper's rig cannot have.
    """
    output = simulate_effects([effect])
    time, channels = output.time[0], effect.about.channels or ("z", "x")
    figure = Figure(figsize=(STYLE.width, 7.5), layout="constrained")
    both, *changes = figure.subplots(1 + len(channels), 1, sharex=True)
    scale, first = label_channel(both, channels[0]), getattr(output, channels[0])
    both.plot(time, scale * first[0], **BEFORE.line, label="without")
    sizes = textwrap.fill(f"with {typical_sizes(effect)}", 2 * LETTERS)
    both.plot(time, scale * first[1], **AFTER.line, label=sizes)
    for axes, name in zip(changes, channels, strict=True):
        scale, channel = label_difference(axes, name, f"change of {name}"), getattr(output, name)
        axes.plot(time, scale * (channel[1] - channel[0]), **AFTER.line)
        axes.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
    changes[-1].set_xlabel("time [s]")
    title_above(figure, f"{effect.about.name}: {effect.about.meaning}")
    legend_below(figure, [both], columns=1)
    return figure


def _shown_in_gallery(effect: type[AbstractEffect]) -> bool:
    """Tell whether the paper's rig can have an effect and its x or z shows it."""
    try:
        effect.about.require_shown(("x", "z"))
        replace(Simulator(), effects=(effect(),)).check()
    except InputError:
        return False
    return True


@project_style
def draw_gallery(effects: Classes) -> Figure:
    """Draw the changes that each effect makes in z and x: their course, and their size.

    The course is drawn to a scale of its own, the largest change on one scale for all effects.
    Effects that a driven carriage, a force or a torque would show are left out.
    """
    effects = [each for each in effects if _shown_in_gallery(each)]
    output = simulate_effects(effects)
    rows = -(-len(effects) // STYLE.columns)
    figure = Figure(figsize=(STYLE.width, 2 + 1.3 * rows), layout="constrained")
    pairs = figure.subplots(
        rows, 2 * STYLE.columns, squeeze=False, sharex="col", width_ratios=(1.2, 1) * STYLE.columns
    ).reshape(-1, 2)
    for spare in pairs[len(effects) :].flat:
        spare.remove()
    for index, ((course, size), effect) in enumerate(zip(pairs, effects, strict=False), start=1):
        changes = {
            name: 1e3 * (getattr(output, name)[index] - getattr(output, name)[0]) for name in "zx"
        }
        _draw_course(course, np.asarray(output.time[0]), changes)
        _draw_size(size, changes)
        title = f"{effect.about.name}\n{textwrap.fill(typical_sizes(effect), LETTERS)}"
        course.set_title(title, loc="left", fontsize=STYLE.small_text)
    # The lowest panels have the axes, also above a place that is empty.
    for course, size in pairs[: len(effects)][-STYLE.columns :]:
        course.set_xlabel("time [s]")
        size.set_xlabel("largest [mm]")
        for axes in (course, size):
            axes.tick_params(labelbottom=True)
    legend_below(figure, [pairs[0, 0]])
    title_above(
        figure,
        "Change by each effect of sinkage (blue, solid) and travel (orange, dashed).\n"
        "Left: the course, to its own scale; deeper is down, forward is up.\n"
        "Right: the largest change, on one scale for all.",
    )
    return figure


KINDS = {"z": ("sinkage", 0, "-"), "x": ("travel", 1, "--")}
"""Words, place among the colours, and dashes of the gallery's channels."""


def _draw_course(axes: Axes, time: np.ndarray, changes: dict[str, np.ndarray]) -> None:
    """Draw changes over time, each as a share of its largest."""
    for name, change in changes.items():
        word, place, dashes = KINDS[name]
        largest = max(np.abs(change).max(), 1e-300)
        axes.plot(time, change / largest, dashes, color=PARTS[place], lw=1.4, label=word)
    axes.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
    axes.set_ylim(-1.1, 1.1)
    axes.set_yticks([])


def _draw_size(axes: Axes, changes: dict[str, np.ndarray]) -> None:
    """Draw the largest changes [mm] as bars on the common scale."""
    low, high = COMMON_SCALE
    for row, (name, change) in enumerate(changes.items()):
        _, place, _ = KINDS[name]
        largest = float(np.abs(change).max())
        width = max(largest - low, 0.0)
        axes.barh(
            row, width, 0.8, left=low, color=PARTS[place], hatch=HATCHES[place], edgecolor="white"
        )
        axes.text(max(largest, low), row, f" {largest:.2g} mm", va="center")
    axes.set_xscale("log")
    # Room for the number beside the longest bar.
    axes.set_xlim(low, 300 * high)
    axes.set_xticks([low, 1, high], [f"{low:g}", "1", f"{high:g}"])
    axes.minorticks_off()
    axes.set_yticks([])
    axes.invert_yaxis()
