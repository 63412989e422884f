"""Figures of the change that effects make to the run of Fuke, Ishikawa & Ishigami 2024."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

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
    """Draw z with and without an effect, and the changes that it makes in z and x."""
    output = simulate_effects([effect])
    time = output.time[0]
    figure = Figure(figsize=(7, 7), layout="constrained")
    both, change_z, change_x = figure.subplots(3, 1, sharex=True)
    both.plot(time, 1e3 * output.z[0], color="0.5", label="without")
    both.plot(time, 1e3 * output.z[1], color=COLOURS[0], label=f"with {typical_sizes(effect)}")
    both.set(title=f"{effect.about.name}: {effect.about.meaning}", ylabel="z [mm]")
    both.legend()
    for axes, name, colour in zip((change_z, change_x), "zx", COLOURS, strict=True):
        channel = getattr(output, name)
        axes.plot(time, 1e3 * (channel[1] - channel[0]), color=colour)
        axes.set_ylabel(f"change of {name} [mm]")
        axes.axhline(0, color="0.8", linewidth=0.8, zorder=0)
    change_x.set_xlabel("time [s]")
    return figure


def draw_gallery(effects: Classes) -> Figure:
    """Draw the changes that each effect makes in z and x, each in a panel of its own."""
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
