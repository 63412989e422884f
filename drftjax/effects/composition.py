"""Composition of effects: all effects of one place of the step, applied in order.

Every function takes the effects and their memories, one for each, in the order given.
"""

import dataclasses
from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import (
    AbstractDrive,
    AbstractEffect,
    AbstractIncline,
    AbstractLoad,
    AbstractPlacement,
    AbstractSandLoad,
    AbstractSensor,
    AbstractStressFactor,
    AbstractSurface,
    AbstractZetaFactor,
    Memory,
    StepContext,
)
from drftjax.physics.stress import PlateMotion
from drftjax.physics.surface_frame import AbstractSurfaceFrame, InclinedFrame, LevelFrame
from drftjax.physics.wheel import Plates

if TYPE_CHECKING:
    from drftjax.physics.state import Output, State

Effects = tuple[AbstractEffect, ...]


Memories = tuple[Memory, ...]


Number = Float[Array, ""]


Pair = Float[Array, "2"]


def initial_readings(effects: Effects, position: Pair, weight: Number) -> Pair:
    """True start (x, z) of the axle [m], from the reading of all sensors together at rest.

    Args:
        effects: All effects.
        position: Reading at rest (x, z) [m].
        weight: Vertical load that the sand carries there [N].
    """
    for effect in reversed(effects):
        if isinstance(effect, AbstractSensor):
            position = effect.started(position, weight)
    return position


def begin(effects: Effects, state: "State") -> Memories:
    """Memories at the start of a run, from the state of the wheel there.

    Those of sensors follow by `begin_reading`, from an output that the other effects act on.
    """

    def of(effect: AbstractEffect) -> Memory:
        match effect:
            case AbstractDrive():
                return effect.begin(state.omega, state.angle)
            case AbstractLoad():
                return effect.begin(state.position)
            case AbstractZetaFactor() | AbstractSurface():
                return effect.begin()
        return ()

    return tuple(of(each) for each in effects)


def begin_reading(effects: Effects, memories: Memories, truth: "Output", dt: Number) -> Memories:
    """Memories with those of the sensors, each begun on the reading of the one before it.

    Args:
        effects, memories: All effects, and their memories by `begin`.
        truth: True output at the start.
        dt: Time that a reading takes [s].
    """
    reading, begun = truth, list(memories)
    for index, effect in enumerate(effects):
        if isinstance(effect, AbstractSensor):
            begun[index] = effect.begin(reading)
            reading, _ = effect.read(reading, dt, begun[index])
    return tuple(begun)


def advance(effects: Effects, memories: Memories, moment: StepContext) -> Memories:
    """Memories of terrain and rig after a step; drives and sensors keep their own."""
    return tuple(
        effect.advance(memory, moment)
        if isinstance(effect, AbstractLoad | AbstractZetaFactor | AbstractSurface)
        else memory
        for effect, memory in zip(effects, memories, strict=True)
    )


def wheel_speed(
    effects: Effects, memories: Memories, commanded: Number, angle: Number, dt: Number
) -> tuple[Number, Memories]:
    """The wheel's angular velocity [rad/s] behind every drive effect."""
    omega, after = commanded, list(memories)
    for index, effect in enumerate(effects):
        if isinstance(effect, AbstractDrive):
            omega, after[index] = effect.turn(omega, angle, dt, memories[index])
    return omega, tuple(after)


def move_plates(effects: Effects, plates: Plates, angle: Number) -> Plates:
    """The plates about the axle, moved to their true places."""
    for effect in effects:
        if isinstance(effect, AbstractPlacement):
            plates = effect.place(plates, angle)
    return plates


def surface_frame(effects: Effects, axle: Number) -> AbstractSurfaceFrame:
    """Frame of the surface at the axle's place x [m]: heights and slopes of all inclines add up."""
    planes = [effect.plane(axle) for effect in effects if isinstance(effect, AbstractIncline)]
    if not planes:
        return LevelFrame()
    heights, rises = zip(*planes, strict=True)
    return InclinedFrame(sum(heights, jnp.zeros_like(axle)), sum(rises, jnp.zeros_like(axle)))


def relative_to_surface(
    effects: Effects,
    memories: Memories,
    motion: PlateMotion,
    axle: Number,
    ahead: Float[Array, " plates"],
) -> PlateMotion:
    """The plates' motion with depths from the true surface; see `AbstractSurface.height`."""
    depth = motion.depth
    for effect, memory in zip(effects, memories, strict=True):
        if isinstance(effect, AbstractSurface):
            depth = depth + effect.height(axle, ahead, memory)
    return dataclasses.replace(motion, depth=depth)


def zeta_factor(effects: Effects, memories: Memories, moment: StepContext) -> Number:
    """Factor on zeta [-] of all effects together."""
    factor = jnp.ones_like(moment.time)
    for effect, memory in zip(effects, memories, strict=True):
        if isinstance(effect, AbstractZetaFactor):
            factor = factor * effect.factor(moment, memory)
    return factor


def stress_factor(effects: Effects, motion: PlateMotion) -> Float[Array, " plates"]:
    """Factor on each plate's stress [-] of all effects together."""
    factor = jnp.ones_like(motion.depth)
    for effect in effects:
        if isinstance(effect, AbstractStressFactor):
            factor = factor * effect.factor(motion)
    return factor


def loads(
    effects: Effects,
    memories: Memories,
    position: Pair,
    velocity: Pair,
    moment: StepContext,
    of_the_sand: bool,
) -> Pair:
    """Further forces (x, z) on the axle [N]: the sand's, or the rig's."""
    force = jnp.zeros_like(position)
    for effect, memory in zip(effects, memories, strict=True):
        if isinstance(effect, AbstractLoad) and isinstance(effect, AbstractSandLoad) == of_the_sand:
            force = force + effect.load(position, velocity, moment, memory)
    return force


def measure(
    effects: Effects, memories: Memories, truth: "Output", dt: Number
) -> tuple["Output", Memories]:
    """Reading of the instruments, and their memories after a step of `dt` [s]."""
    reading, after = truth, list(memories)
    for index, effect in enumerate(effects):
        if isinstance(effect, AbstractSensor):
            reading, after[index] = effect.read(reading, dt, memories[index])
    return reading, tuple(after)
