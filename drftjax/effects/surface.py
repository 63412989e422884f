"""Terrain: a surface that is not level, or does not stay so."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects import spatial as places
from drftjax.effects.base import (
    AbstractIncline,
    AbstractPlane,
    EffectInfo,
    Memory,
    MemorylessSurface,
    StepContext,
    shape,
    strength,
)

Number = Float[Array, ""]
Each = Float[Array, " plates"]


def _waves(cosine: Number, sine: Number, length: Number, axle: Number) -> tuple[Number, Number]:
    """Height [m] over that at x = 0, and slope [-], of waves along x at the axle [m]."""
    turn = 2 * jnp.pi / length
    across, along = jnp.cos(turn * axle), jnp.sin(turn * axle)
    return cosine * (across - 1) + sine * along, turn * (sine * across - cosine * along)


class SurfaceProfile(AbstractPlane, MemorylessSurface):
    """Height waves along x; the datum is the height at x = 0.

    The theory knows sand with a flat surface, so the wheel is on the plane that touches the wave
    under its axle.
    """

    about: ClassVar = EffectInfo(
        "surface_profile",
        "terrain",
        "h = cosine (cos(2π x / length) - 1) + sine sin(2π x / length), a plane under the wheel",
        "the surface is not flat: height waves in x",
    )
    cosine: Number = strength("m", 0.001, "amplitude in phase with x = 0")
    sine: Number = strength("m", 0.001, "amplitude a quarter wave on")
    length: Number = places.wavelength()

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return _waves(self.cosine, self.sine, self.length, axle)


class SurfaceUndulation(AbstractIncline):
    """Height waves along x, with depths, directions and forces in the frame of the surface.

    As with `SurfaceProfile`, the wheel is on the plane that touches the wave under its axle; here
    the sand's force leans with that plane, so that a wheel is driven off a crest. The plates are
    turned at every place that a step tries: a step takes a third longer than with `SurfaceProfile`,
    so a diagnosis looks for it only where it is named.
    """

    about: ClassVar = EffectInfo(
        "surface_undulation",
        "terrain",
        "h = cosine (cos(2π x / length) - 1) + sine sin(2π x / length), stress in its frame",
        "the surface is not flat: height waves in x, and the sand's force leans with them",
        form_of="surface_profile",
        hypothesis=False,
    )
    cosine: Number = strength("m", 0.001, "amplitude in phase with x = 0")
    sine: Number = strength("m", 0.001, "amplitude a quarter wave on")
    length: Number = places.wavelength()

    def plane(self, axle: Number) -> tuple[Number, Number]:
        return _waves(self.cosine, self.sine, self.length, axle)


class SurfaceWaves(MemorylessSurface):
    """Two height waves along x, under each plate for itself; the datum is the height at x = 0.

    Where waves are hardly longer than the wheel no plane touches them all along it.
    """

    about: ClassVar = EffectInfo(
        "surface_waves",
        "terrain",
        "h = Σ cosine (cos(2π x / length) - 1) + sine sin(2π x / length), at each plate",
        "the surface is not flat: height waves of two lengths in x, shorter than the wheel or not",
        form_of="surface_profile",
        hypothesis=False,
        sum_of="surface_profile",
    )
    first_cosine: Number = strength("m", 0.001, "amplitude of the first in phase with x = 0")
    first_sine: Number = strength("m", 0.001, "its amplitude a quarter wave on")
    second_cosine: Number = strength("m", 0.001, "amplitude of the second in phase with x = 0")
    second_sine: Number = strength("m", 0.001, "its amplitude a quarter wave on")
    first_length: Number = places.one_wavelength(0.4, 0.8, 1.6)
    second_length: Number = places.one_wavelength(0.1, 0.2, 0.4)

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        x = axle + ahead
        first = places.wave(self.first_cosine, self.first_sine, self.first_length, x)
        second = places.wave(self.second_cosine, self.second_sine, self.second_length, x)
        return first + second - self.first_cosine - self.second_cosine


class SurfaceBump(AbstractPlane, MemorylessSurface):
    """One bump or dip along x; the datum is the height at x = 0.

    As on waves, the wheel is on the plane that touches the surface under its axle.
    """

    about: ClassVar = EffectInfo(
        "surface_bump",
        "terrain",
        "h = rise exp(-(x - centre)² / (2 width²)), less that at x = 0, a plane under the wheel",
        "the surface is not flat: a bump or a dip at one place",
        form_of="surface_profile",
    )
    rise: Number = strength("m", 0.002, "height over the level around it")
    centre: Number = places.centre("bump")
    width: Number = places.width()

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        def level(x: Number) -> Number:
            return self.rise * places.bell(x, self.centre, self.width)

        here, rise = jax.value_and_grad(level)(axle)
        return here - level(jnp.zeros_like(axle)), rise


class SurfaceSlope(AbstractPlane, MemorylessSurface):
    """The surface is inclined."""

    about: ClassVar = EffectInfo(
        "surface_slope", "terrain", "h = slope x", "the surface is inclined"
    )
    slope: Number = strength("-", 0.01, "rise of the surface along x")

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return self.slope * axle, self.slope


class SurfaceIncline(AbstractIncline):
    """The surface is inclined, with depths, directions and forces in its frame.

    It moves a wheel as a tilt of gravity does. A diagnosis looks for it: a step takes as long as
    with `SurfaceSlope`, and on a true slope that one has less than half of the change of x.
    """

    about: ClassVar = EffectInfo(
        "surface_incline",
        "terrain",
        "h = slope x, stress in its frame",
        "the surface is inclined, and the sand's force leans with it",
        form_of="surface_slope",
    )
    slope: Number = strength("-", 0.01, "rise of the surface along x")

    def plane(self, axle: Number) -> tuple[Number, Number]:
        return self.slope * axle, self.slope


class Excavation(AbstractPlane):
    """Slip digs: the surface under the wheel goes down with slip distance."""

    about: ClassVar = EffectInfo(
        "excavation",
        "terrain",
        "h = -rate ∫ |r ω - v_x| dt",
        "slip digs: the surface under the wheel goes down with slip distance",
    )
    rate: Number = strength("-", 0.1, "depth dug per slip distance", least=0.0)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.rate)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory + moment.dt * jnp.abs(moment.rim_slip())

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return -self.rate * memory, jnp.zeros_like(axle)


class SlipSinkage(AbstractPlane):
    """Slip carries sand away from under the wheel, which moves on to fresh sand.

    At an even slip ratio i the surface settles at -rate length i / (1 - i).
    """

    about: ClassVar = EffectInfo(
        "slip_sinkage",
        "terrain",
        "h = -rate s, ds/dt = |r ω - v_x| - s |v_x| / length",
        "slip carries sand away: the surface goes down with slip, and recovers with travel",
    )
    rate: Number = strength("-", 0.1, "depth dug per slip distance", least=0.0)
    length: Number = shape("m", 0.12, (0.03, 0.06, 0.12, 0.25), "travel that leads to fresh sand")

    def begin(self) -> Memory:
        return jnp.zeros_like(self.rate)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # Implicit, so that a long step leaves nothing below zero.
        dug = memory + moment.dt * jnp.abs(moment.rim_slip())
        return dug / (1 + moment.dt * jnp.abs(moment.velocity[0]) / self.length)

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return -self.rate * memory, jnp.zeros_like(axle)


SURFACE = (
    SurfaceProfile,
    SurfaceUndulation,
    SurfaceWaves,
    SurfaceBump,
    SurfaceSlope,
    SurfaceIncline,
    Excavation,
    SlipSinkage,
)
