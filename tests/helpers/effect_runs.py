"""Runs with any effects at any strength, by one program: an absent effect has strength zero."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.effects.catalogue import OURS, field_metadata, strengths
from drftjax.physics.command import Command
from drftjax.physics.state import Output, State
from drftjax.physics.stress import AbstractStressLaw, Dynamic
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import AbstractWheel, GrouserWheel, PlainWheel
from drftjax.simulation.rollout import simulate, with_first_row
from drftjax.simulation.simulator import Simulator

# Coarse plates, so that tests are quick.
GROUSERS = GrouserWheel(plate_size=0.010)
RIM = PlainWheel(plate_size=0.005)

# Every number of every effect, in one order: (effect, field).
NUMBERS = tuple((each.about.name, field) for each in OURS for field in field_metadata(each))
STRENGTHS = tuple((each.about.name, field) for each in OURS for field in strengths(each))
KNOWN = {each.about.name: each for each in OURS}
# Those that a free carriage can have.
ON_FREE = tuple(name for name in KNOWN if name != "carriage_gain")


def typical(name: str) -> dict[str, float]:
    """Typical strengths of an effect, by field."""
    about = field_metadata(KNOWN[name])
    return {field: about[field]["typical"] for field in strengths(KNOWN[name])}


def vector(**given: dict[str, float]) -> np.ndarray:
    """Numbers of all effects: those given, and otherwise strength zero and default shapes."""
    return np.asarray(
        [
            given.get(name, {}).get(field, float(getattr(KNOWN[name](), field)))
            for name, field in NUMBERS
        ]
    )


def built(values, leave_out: tuple[str, ...] = (), only: tuple[str, ...] = tuple(KNOWN)):
    """Build effects from the numbers of all, without some of them."""
    fields: dict[str, dict] = {name: {} for name in KNOWN}
    for (name, field), value in zip(NUMBERS, values, strict=True):
        fields[name][field] = value
    return tuple(KNOWN[name](**fields[name]) for name in only if name not in leave_out)


def simulator(wheel: AbstractWheel = GROUSERS, law: AbstractStressLaw | None = None) -> Simulator:
    return Simulator(wheel, Terrain(law=Dynamic() if law is None else law))


def commands(omega, vx=0.0) -> Command:
    omega = jnp.asarray(omega, float)
    return Command(omega, jnp.zeros_like(omega) + vx, jnp.zeros_like(omega))


def with_effects(
    wheel: AbstractWheel,
    values,
    only: tuple[str, ...] = tuple(KNOWN),
    law: AbstractStressLaw | None = None,
) -> Simulator:
    sim, leave_out = simulator(wheel, law), ("carriage_gain",)
    if not isinstance(wheel, GrouserWheel):
        leave_out += ("grouser_height", "grouser_shadowing")
    return replace(sim, effects=built(values, leave_out, only))


def rows(sim: Simulator, start: State, omega, dt, every: int, vx=0.0) -> Output:
    """Output at the start and after every `every` steps; `vx` is for a driven carriage."""
    command = commands(omega, vx)
    after = simulate(sim, start, command, dt, every=every)[1]
    return with_first_row(sim, start, jax.tree.map(lambda c: c[0], command), after)


@cache
def driven(smooth: bool, speed: float, dt: float = 1e-3, seconds: float = 2.0) -> State:
    """State of a smooth or grousered wheel that was driven at a speed [rad/s] for some seconds."""
    sim = simulator(RIM if smooth else GROUSERS)
    steps = round(seconds / dt)
    omega = speed * np.minimum(1, np.arange(1, steps + 1) / (0.5 * steps))
    run = jax.jit(lambda start: simulate(sim, start, commands(omega), dt)[0])
    state = run(State.at_rest(0.02))
    nought = jnp.zeros(())
    return replace(state, time=nought, position=state.position.at[0].set(0.0), memory=())
