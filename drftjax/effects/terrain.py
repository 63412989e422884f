"""Terrain: sand whose strength or resistance changes under the wheel, with its history or place."""

from typing import ClassVar

import jax.numpy as jnp
from equinox import AbstractVar
from jaxtyping import Array, Float

from drftjax.effects import spatial as places
from drftjax.effects.base import (
    AbstractSandLoad,
    AbstractZetaFactor,
    EffectInfo,
    Memory,
    MemorylessLoad,
    MemorylessZetaFactor,
    StepContext,
    along_x,
    shape,
    strength,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Regulariser: way [m] that the rim turns back over which a wheel parts from the pile ahead of it.
PARTING = 0.01


# Regulariser: speed [m/s] over which a heap comes to stand ahead of the wheel, and below which a
# slip ratio fades.
CREEP = 1e-3


# Sinkage [m] that a heap's forces are given at.
HEAPED_SINKAGE = 0.02


# Sinkage [m] at which hardening by sinkage changes nothing, and below which its factor is held.
REFERENCE_SINKAGE, LEAST_SINKAGE = 0.02, 1e-3


# Turning [rad] below which a stretched loosening holds its loss: a power of nought has no slope.
FIRST_TURNING = 1e-3


class AbstractLoosening(AbstractZetaFactor):
    """zeta falls with the wheel's accumulated turning, either way, towards a floor."""

    loss: AbstractVar[Number]

    def begin(self) -> Memory:
        return jnp.zeros_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory + moment.dt * jnp.abs(moment.omega)


class Loosening(AbstractLoosening):
    """zeta falls with the wheel's accumulated turning, towards a floor."""

    about: ClassVar = EffectInfo(
        "loosening",
        "terrain",
        "ζ = ζ (1 - loss (1 - exp(-turning / decay)))",
        "zeta falls with the wheel's accumulated turning, towards a floor",
    )
    loss: Number = strength("-", 0.1, "share of zeta lost in the end", least=0.0, most=1.0)
    decay: Number = shape("rad", 2.0, (0.3, 0.7, 1.5, 3.0, 6.0, 12.0), "turning that loosens")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return 1 - self.loss * (1 - jnp.exp(-memory / self.decay))


class LooseningStretched(AbstractLoosening):
    """zeta falls with the wheel's accumulated turning: early and long, or late and at once.

    A stretched exponential (Kohlrausch's relaxation) has a long tail at exponents below one. Above
    one the loss begins late, and its floor is reached soon after.
    """

    about: ClassVar = EffectInfo(
        "loosening_stretched",
        "terrain",
        "ζ = ζ (1 - loss (1 - exp(-(turning / decay)^exponent)))",
        "zeta falls with the wheel's accumulated turning, early and long, or late and at once",
        form_of="loosening",
    )
    loss: Number = strength("-", 0.1, "share of zeta lost in the end", least=0.0, most=1.0)
    decay: Number = shape("rad", 2.0, (0.5, 1.5, 4.0, 12.0), "turning that loosens")
    exponent: Number = shape("-", 1.5, (0.6, 1.6), "below 1: a long tail; above 1: a late loss")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        turned = jnp.maximum(memory, FIRST_TURNING) / self.decay
        return 1 - self.loss * (1 - jnp.exp(-(turned**self.exponent)))


class SlipSoftening(MemorylessZetaFactor):
    """zeta is lower the faster the rim slips."""

    about: ClassVar = EffectInfo(
        "slip_softening",
        "terrain",
        "ζ = ζ (1 - loss s / (s + half)), s = |r ω - v_x|",
        "zeta is lower the faster the rim slips",
    )
    loss: Number = strength(
        "-", 0.1, "share of zeta lost at fast slip", far=(0.5, 0.8), least=0.0, most=1.0
    )
    half: Number = shape("m/s", 0.01, (0.0005, 0.002, 0.01, 0.05), "slip speed of half the loss")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        slip = jnp.abs(moment.rim_slip())
        return 1 - self.loss * slip / (slip + self.half)


class SlipRatioSoftening(MemorylessZetaFactor):
    """zeta is lower the larger the slip ratio, at any speed."""

    about: ClassVar = EffectInfo(
        "slip_ratio_softening",
        "terrain",
        "ζ = ζ (1 - loss i), i = |r ω - v_x| / max(|r ω|, |v_x|)",
        "zeta is lower the larger the slip ratio, at any speed",
        form_of="slip_softening",
    )
    loss: Number = strength(
        "-", 0.1, "share of zeta lost on the spot", far=(0.5,), least=0.0, most=1.0
    )

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        rim, speed = jnp.abs(moment.radius * moment.omega), jnp.abs(moment.velocity[0])
        slip = jnp.abs(moment.rim_slip()) / jnp.maximum(jnp.maximum(rim, speed), CREEP)
        return 1 - self.loss * slip


class SlipPowerSoftening(MemorylessZetaFactor):
    """zeta falls with the rim's slip without an end, by a power of it.

    At small exponents it falls by the logarithm of slip, as rate-and-state friction does, and far
    below the onset in proportion to slip.
    """

    about: ClassVar = EffectInfo(
        "slip_power_softening",
        "terrain",
        "ζ = ζ (1 + s / onset)^-exponent, s = |r ω - v_x|",
        "zeta is lower the faster the rim slips, without an end",
        form_of="slip_softening",
    )
    exponent: Number = strength(
        "-", 0.05, "power of slip by which zeta falls", far=(0.3,), least=0.0
    )
    onset: Number = shape(
        "m/s", 0.01, (0.0005, 0.002, 0.01, 0.05), "slip speed from which it falls"
    )

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        slip = jnp.abs(moment.rim_slip())
        return jnp.exp(-self.exponent * jnp.log1p(slip / self.onset))


class SinkageHardening(MemorylessZetaFactor):
    """zeta grows with the wheel's sinkage, alike under all of its plates."""

    about: ClassVar = EffectInfo(
        "sinkage_hardening",
        "terrain",
        "ζ = ζ (H / 20 mm)^excess, from 1 mm of sinkage on",
        "stress is not linear in depth: zeta grows with the wheel's sinkage",
        form_of="depth_hardening",
    )
    excess: Number = strength("-", 0.1, "exponent of sinkage less that of stress by depth")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        sinkage = jnp.maximum(-moment.position[1], LEAST_SINKAGE) / REFERENCE_SINKAGE
        return jnp.exp(self.excess * jnp.log(sinkage))


class TerrainVariation(MemorylessZetaFactor):
    """zeta depends on the place: a soft or hard patch."""

    about: ClassVar = EffectInfo(
        "terrain_variation",
        "terrain",
        "ζ = ζ (1 + excess exp(-(x - centre)² / (2 width²)))",
        "zeta depends on the place: a soft or hard patch, an uneven preparation",
    )
    excess: Number = strength("-", 0.1, "excess of zeta at the patch's centre")
    centre: Number = places.centre("patch")
    width: Number = places.width()

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return 1 + self.excess * places.bell(moment.position[0], self.centre, self.width)


class TerrainWave(MemorylessZetaFactor):
    """zeta depends on the place: waves along x."""

    about: ClassVar = EffectInfo(
        "terrain_wave",
        "terrain",
        "ζ = ζ (1 + cosine cos(2π x / length) + sine sin(2π x / length))",
        "zeta depends on the place: waves that a preparation leaves",
        form_of="terrain_variation",
    )
    cosine: Number = strength("-", 0.05, "amplitude in phase with x = 0")
    sine: Number = strength("-", 0.05, "amplitude a quarter wave on")
    length: Number = places.wavelength()

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return 1 + places.wave(self.cosine, self.sine, self.length, moment.position[0])


class TerrainWaves(MemorylessZetaFactor):
    """zeta depends on the place: three waves along x."""

    about: ClassVar = EffectInfo(
        "terrain_waves",
        "terrain",
        "ζ = ζ (1 + Σ cosine cos(2π x / length) + sine sin(2π x / length))",
        "zeta depends on the place: waves of three lengths",
        form_of="terrain_variation",
        hypothesis=False,
        sum_of="terrain_wave",
    )
    first_cosine: Number = strength("-", 0.05, "amplitude of the first in phase with x = 0")
    first_sine: Number = strength("-", 0.05, "its amplitude a quarter wave on")
    second_cosine: Number = strength("-", 0.05, "amplitude of the second in phase with x = 0")
    second_sine: Number = strength("-", 0.05, "its amplitude a quarter wave on")
    third_cosine: Number = strength("-", 0.05, "amplitude of the third in phase with x = 0")
    third_sine: Number = strength("-", 0.05, "its amplitude a quarter wave on")
    first_length: Number = places.one_wavelength(0.8, 1.6)
    second_length: Number = places.one_wavelength(0.3, 0.6)
    third_length: Number = places.one_wavelength(0.1, 0.2)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        x = moment.position[0]
        first = places.wave(self.first_cosine, self.first_sine, self.first_length, x)
        second = places.wave(self.second_cosine, self.second_sine, self.second_length, x)
        third = places.wave(self.third_cosine, self.third_sine, self.third_length, x)
        return 1 + first + second + third


class TerrainStep(MemorylessZetaFactor):
    """zeta passes from one level to another along x; a wide passage is a ramp."""

    about: ClassVar = EffectInfo(
        "terrain_step",
        "terrain",
        "ζ = ζ (1 + excess tanh((x - centre) / width))",
        "zeta depends on the place: it passes from one level to another",
        form_of="terrain_variation",
    )
    excess: Number = strength("-", 0.1, "excess of zeta far ahead over that at the centre")
    centre: Number = places.centre("passage")
    width: Number = places.width("half of the passage along x")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return 1 + self.excess * jnp.tanh((moment.position[0] - self.centre) / self.width)


class Bulldozing(AbstractSandLoad):
    """Sand piles up ahead: a resistance that grows with travel and saturates.

    A wheel that turns back leaves its pile, and begins another on its other side.
    """

    about: ClassVar = EffectInfo(
        "bulldozing",
        "terrain",
        "F_x = -force (1 - exp(-|travel| / length)) sign(travel)",
        "sand piles up ahead: resistance that grows with travel and saturates",
    )
    force: Number = strength("N", 5.0, "resistance in the end", least=0.0)
    length: Number = shape("m", 0.3, (0.05, 0.15, 0.4, 1.0), "travel that piles it up")

    def begin(self, position: Pair) -> Memory:
        nought = jnp.zeros_like(position[0])
        return position[0], nought, nought

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # Where the pile began, the sense in which the wheel heaps it up, how far it turned back.
        began, sense, back = memory
        sense = jnp.where(sense == 0, jnp.sign(moment.omega), sense)
        rim = moment.dt * moment.radius * moment.omega
        back = jnp.clip(back - sense * rim, 0, PARTING)
        left = back >= PARTING
        return (
            jnp.where(left, moment.position[0], began),
            jnp.where(left, -sense, sense),
            jnp.where(left, 0, back),
        )

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        began, _, back = memory
        travel = position[0] - began
        piled = 1 - jnp.exp(-jnp.abs(travel) / self.length)
        return along_x(-self.force * jnp.sign(travel) * piled * (1 - back / PARTING))


class Heap(MemorylessLoad, AbstractSandLoad):
    """A heap ahead of a deep or braked wheel holds it back and bears some of its load.

    Braked slip is b = 1 - r ω / v_x, from 0 where the wheel rolls or drives to 1 where it is locked
    or turns against the travel.
    """

    about: ClassVar = EffectInfo(
        "heap",
        "terrain",
        "F_x = -resistance q d, F_z = lift q d², q = (H / 20 mm)² (1 + braking b), "
        "d = tanh(v_x / 1 mm/s)",
        "a heap ahead of a braked or deep wheel: resistance and lift with sinkage squared",
    )
    resistance: Number = strength(
        "N", 2.0, "force against the travel at 20 mm of sinkage", least=0.0
    )
    lift: Number = strength("N", 1.0, "force upward at 20 mm of sinkage", least=0.0)
    braking: Number = shape("-", 2.0, (0.5, 2.0, 8.0), "growth of both from rolling to locked")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        speed, rim = velocity[0], moment.radius * moment.omega
        braked = jnp.clip(speed * (speed - rim) / (speed**2 + CREEP**2), 0, 1)
        sinkage = jnp.maximum(-position[1], 0) / HEAPED_SINKAGE
        size = sinkage**2 * (1 + self.braking * braked)
        way = jnp.tanh(speed / CREEP)
        return size * jnp.stack([-self.resistance * way, self.lift * way**2])


TERRAIN = (
    Loosening,
    LooseningStretched,
    SlipSoftening,
    SlipRatioSoftening,
    SlipPowerSoftening,
    SinkageHardening,
    TerrainVariation,
    TerrainWave,
    TerrainWaves,
    TerrainStep,
    Bulldozing,
    Heap,
)
