"""Figures of the change that effects make to the run of Fuke, Ishikawa & Ishigami 2024."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from drftjax.common.errors import InputError
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


COLOURS = ("tab:blue", "tab:orange")


# Unit of each channel in a figure, and its number in an SI unit.
UNITS = {"x": ("mm", 1e3), "z": ("mm", 1e3), "fx": ("N", 1), "fz": ("N", 1), "torque": ("N m", 1)}


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


def draw_effect(effect: type[AbstractEffect]) -> Figure:
    """Draw z with and without an effect, and the changes that it makes in z and x.

    Of an effect that shows in other channels alone, these are drawn.

    Raises:
        InputError: for an effect that the paper's rig cannot have.
    """
    output = simulate_effects([effect])
    time, channels = output.time[0], effect.about.channels or ("z", "x")
    figure = Figure(figsize=(7, 7), layout="constrained")
    both, *changes = figure.subplots(1 + len(channels), 1, sharex=True)
    (unit, scale), first = UNITS[channels[0]], getattr(output, channels[0])
    both.plot(time, scale * first[0], color="0.5", label="without")
    both.plot(time, scale * first[1], color=COLOURS[0], label=f"with {typical_sizes(effect)}")
    title = f"{effect.about.name}: {effect.about.meaning}"
    both.set_title(title, wrap=True)
    both.set_ylabel(f"{channels[0]} [{unit}]")
    both.legend()
    for axes, name, colour in zip(changes, channels, COLOURS, strict=False):
        (unit, scale), channel = UNITS[name], getattr(output, name)
        axes.plot(time, scale * (channel[1] - channel[0]), color=colour)
        axes.set_ylabel(f"change of {name} [{unit}]")
        axes.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    changes[-1].set_xlabel("time [s]")
    return figure


def _shown_in_gallery(effect: type[AbstractEffect]) -> bool:
    """Tell whether the paper's rig can have an effect and its x or z shows it."""
    try:
        effect.about.require_shown(("x", "z"))
        replace(Simulator(), effects=(effect(),)).check()
    except InputError:
        return False
    return True


def draw_gallery(effects: Classes) -> Figure:
    """Draw the changes that each effect makes in z and x, each in a panel of its own.

    Effects that a driven carriage, a force or a torque would show are left out.
    """
    effects = [each for each in effects if _shown_in_gallery(each)]
    output = simulate_effects(effects)
    columns = min(6, len(effects))
    lines = math.ceil(len(effects) / columns)
    figure = Figure(figsize=(2.5 * columns, 1.8 * lines), layout="constrained")
    panels = figure.subplots(lines, columns, sharex=True, squeeze=False).ravel()
    for panel in panels[len(effects) :]:
        panel.remove()
    for index, (panel, effect) in enumerate(zip(panels, effects, strict=False), start=1):
        for axes, name, colour in zip((panel, panel.twinx()), "zx", COLOURS, strict=True):
            channel = getattr(output, name)
            axes.plot(output.time[0], 1e3 * (channel[index] - channel[0]), color=colour)
            axes.tick_params(axis="y", colors=colour, labelsize=6)
            axes.locator_params(axis="y", nbins=4)
        panel.set_title(f"{effect.about.name}\n{typical_sizes(effect)}", fontsize=7)
    figure.suptitle("Change of z (blue, left, mm) and of x (orange, right, mm) over time in s")
    return figure
