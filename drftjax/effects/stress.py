"""Terrain: a stress law other than the model's."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects.base import (
    AbstractAdjustment,
    AbstractStressFactor,
    Adjustable,
    EffectInfo,
    Model,
    shape,
    strength,
)
from drftjax.physics.stress import ArcBisector, Dynamic, PlateMotion, WeightedBisector

Number = Float[Array, ""]


Each = Float[Array, " plates"]


# Depth [m] that depth_hardening and depth_power pivot about, and rigid_floor and cohesion are
# measured in.
REFERENCE_DEPTH = 0.02


# Regulariser: depth [m] from which a power of depth counts: its derivative has none at the surface.
LEAST_DEPTH = 1e-4


# Regulariser: depth [m] over which cohesion fades in under the surface.
ONSET_DEPTH = 0.002


class RateHardening(AbstractStressFactor):
    """Stress grows with plate speed beyond the inertial term."""

    about: ClassVar = EffectInfo(
        "rate_hardening",
        "terrain",
        "σ = σ (1 + excess p / (p + half)), p the plate's speed",
        "stress grows with plate speed beyond the inertial term",
    )
    excess: Number = strength("-", 0.1, "excess of stress at high speed", least=0.0)
    half: Number = shape("m/s", 0.1, (0.01, 0.05, 0.2, 1.0), "plate speed of half the excess")

    def factor(self, motion: PlateMotion) -> Each:
        speed = jnp.sqrt(motion.velocity_x**2 + motion.velocity_z**2 + 1e-12)
        return 1 + self.excess * speed / (speed + self.half)


class DepthHardening(AbstractStressFactor):
    """Stress is not linear in depth."""

    about: ClassVar = EffectInfo(
        "depth_hardening",
        "terrain",
        "σ = σ (1 + excess (d / 20 mm - 1))",
        "stress is not linear in depth",
    )
    excess: Number = strength("-", 0.1, "excess of stress per 20 mm below 20 mm of depth")

    def factor(self, motion: PlateMotion) -> Each:
        return 1 + self.excess * (motion.depth / REFERENCE_DEPTH - 1)


class DepthPower(AbstractStressFactor):
    """Stress grows with a power of depth."""

    about: ClassVar = EffectInfo(
        "depth_power",
        "terrain",
        "σ = σ (d / 20 mm)^excess, from 0.1 mm of depth on",
        "stress is a power of depth, of the exponent 1 + excess",
        form_of="depth_hardening",
    )
    excess: Number = strength("-", 0.1, "exponent of depth less 1", least=-0.9)

    def factor(self, motion: PlateMotion) -> Each:
        depth = jnp.maximum(motion.depth, LEAST_DEPTH) / REFERENCE_DEPTH
        return jnp.exp(self.excess * jnp.log(depth))


class RigidFloor(AbstractStressFactor):
    """The bed is shallow: it stiffens below some depth."""

    about: ClassVar = EffectInfo(
        "rigid_floor",
        "terrain",
        "σ = σ (1 + excess max(d - floor, 0) / 20 mm)",
        "the bed is shallow: it stiffens below some depth",
    )
    excess: Number = strength(
        "-", 0.5, "excess of stress per 20 mm below the floor's depth", least=0.0
    )
    # Of wheels of 40 to 300 mm.
    floor: Number = shape(
        "m", 0.035, (0.01, 0.016, 0.025, 0.035, 0.05, 0.075, 0.11), "depth at which it begins"
    )

    def factor(self, motion: PlateMotion) -> Each:
        return 1 + self.excess * jnp.maximum(motion.depth - self.floor, 0) / REFERENCE_DEPTH


class Cohesion(AbstractStressFactor):
    """A stress that does not depend on depth: that of a further depth everywhere below ground."""

    about: ClassVar = EffectInfo(
        "cohesion",
        "terrain",
        "σ = σ (d + depth) / d, fading in over 2 mm",
        "a stress that does not depend on depth",
    )
    depth: Number = strength("m", 0.002, "depth whose stress the cohesion has", least=0.0)

    def factor(self, motion: PlateMotion) -> Each:
        return 1 + self.depth / jnp.maximum(motion.depth, ONSET_DEPTH)


def _dynamic(model: Adjustable, name: str) -> Dynamic:
    law = model.terrain.law
    if not isinstance(law, Dynamic):
        raise InputError(f"{name} needs the dynamic stress law, if with its terms at 0")
    return law


class MomentumFlux(AbstractAdjustment):
    """The inertial term is absent or wrong in the model."""

    about: ClassVar = EffectInfo(
        "momentum_flux",
        "terrain",
        "λ = λ + excess",
        "the inertial term lambda rho v_n^2 is absent or wrong in the model",
    )
    excess: Number = strength("-", 1.0, "true lambda less the model's")

    def adjust(self, model: Model) -> Model:
        true = _dynamic(model, "momentum_flux").inertial_coefficient + self.excess
        return eqx.tree_at(lambda s: s.terrain.law.inertial_coefficient, model, true)


class HeightDecrease(AbstractAdjustment):
    """The height decrease behind the wheel is absent or wrong in the model."""

    about: ClassVar = EffectInfo(
        "height_decrease",
        "terrain",
        "δ_h = δ_h + excess r (r ω² / g)",
        "the height decrease delta_h behind the wheel is absent or wrong in the model",
    )
    excess: Number = strength("-", 1.0, "true share of delta_h less the model's")

    def adjust(self, model: Model) -> Model:
        true = _dynamic(model, "height_decrease").height_decrease + self.excess
        return eqx.tree_at(lambda s: s.terrain.law.height_decrease, model, true)


class HeightDecreaseArc(AbstractAdjustment):
    """The sand is lower behind the middle of the arc that truly touches, not behind the vertical.

    Agarwal et al. 2021, Science Advances 7:eabe0631, halve that arc; `ArcBisector` has the formula.
    The faster a wheel turns, the shorter the arc is behind, and the more of it counts as behind.
    A law without a height decrease has none to move: there `HeightDecrease` comes first.

    A diagnosis looks for it: a step takes less than a tenth longer, and above 90 deg/s the sinkage
    hangs on the line.
    """

    about: ClassVar = EffectInfo(
        "height_decrease_arc",
        "terrain",
        "d = d - δ_h ((1 - share) [behind the model's line] + share [behind the arc's middle])",
        "the height decrease delta_h begins at the middle of the arc that truly touches",
        form_of="height_decrease",
    )
    share: Number = strength("-", 1.0, "share of delta_h that begins at the arc's middle", least=0)

    def adjust(self, model: Model) -> Model:
        law = _dynamic(model, "height_decrease_arc")
        line = WeightedBisector(law.bisector, ArcBisector(), self.share)
        changed = dataclasses.replace(law, bisector=line)
        return eqx.tree_at(lambda s: s.terrain.law, model, changed)


STRESS = (
    RateHardening,
    DepthHardening,
    DepthPower,
    RigidFloor,
    Cohesion,
    MomentumFlux,
    HeightDecrease,
    HeightDecreaseArc,
)
