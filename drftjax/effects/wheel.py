"""Wheel effects: its true shape and mass differ from the set-up."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.effects.base import (
    AbstractAdjustment,
    AbstractPlacement,
    EffectInfo,
    Memory,
    MemorylessLoad,
    Model,
    StepContext,
    strength,
)
from drftjax.physics.outline_wheel import OutlineWheel
from drftjax.physics.wheel import LARGEST_RADIUS, SMALLEST_RADIUS, GrouserWheel, Plates

Number = Float[Array, ""]


class WheelRadius(AbstractAdjustment):
    """The rim's true radius differs; an outline is larger in proportion."""

    about: ClassVar = EffectInfo(
        "wheel_radius", "wheel", "r = r + excess", "the rim's true radius differs"
    )
    excess: Number = strength("m", 0.003, "true radius less the stated one")

    def adjust(self, model: Model) -> Model:
        radius = model.wheel.radius + self.excess
        require_between("the wheel's true radius", radius, SMALLEST_RADIUS, LARGEST_RADIUS, " m")
        if isinstance(model.wheel, OutlineWheel):
            larger = model.wheel.points * (radius / model.wheel.radius)
            model = eqx.tree_at(lambda s: s.wheel.points, model, larger)
        return eqx.tree_at(lambda s: s.wheel.radius, model, radius)


class GrouserHeight(AbstractAdjustment):
    """Grousers are shorter or longer."""

    about: ClassVar = EffectInfo(
        "grouser_height",
        "wheel",
        "h_g = h_g + excess",
        "grousers are shorter, longer or absent",
    )
    excess: Number = strength("m", 0.003, "true height less the stated one")

    def adjust(self, model: Model) -> Model:
        if not isinstance(model.wheel, GrouserWheel):
            raise InputError("grouser_height needs a wheel with grousers")
        height = model.wheel.grouser_height + self.excess
        # A rounding below none is none.
        require_between("the grousers' true height", height, -1e-9, LARGEST_RADIUS, " m")
        return eqx.tree_at(lambda s: s.wheel.grouser_height, model, height)


class GrouserShadowing(AbstractAdjustment):
    """Sand between grousers moves with the wheel, so that only their outer part carries.

    The rim and the grousers' tips carry as before.
    """

    about: ClassVar = EffectInfo(
        "grouser_shadowing",
        "wheel",
        "faces of grousers carry from r + share h_g to r + h_g",
        "sand between grousers moves with the wheel: only the outer share of their height carries",
    )
    share: Number = strength(
        "-", 0.3, "inner share of the height that carries nothing", least=0.0, most=1.0
    )

    def adjust(self, model: Model) -> Model:
        if not isinstance(model.wheel, GrouserWheel):
            raise InputError("grouser_shadowing needs a wheel with grousers")
        shadow = model.wheel.grouser_shadow + self.share
        require_between("the grousers' shadowed share", shadow, 0.0, 1.0)
        return eqx.tree_at(lambda s: s.wheel.grouser_shadow, model, shadow)


class Eccentricity(AbstractPlacement):
    """The axle is off the wheel's centre; z = 0 is where a centred wheel would touch."""

    about: ClassVar = EffectInfo(
        "eccentricity",
        "wheel",
        "centre - axle = R(φ) (along, up), R(φ) turning with the wheel",
        "the axle is off centre: once a turn",
    )
    along: Number = strength("m", 0.001, "offset of the centre, forward at angle zero")
    up: Number = strength("m", 0.001, "offset of the centre, upward at angle zero")

    def place(self, plates: Plates, angle: Number) -> Plates:
        cosine, sine = jnp.cos(angle), jnp.sin(angle)
        x = self.along * cosine + self.up * sine
        z = self.up * cosine - self.along * sine
        return dataclasses.replace(plates, x=plates.x + x, z=plates.z + z)


class Imbalance(MemorylessLoad):
    """Mass off the axle pulls outward with the square of the speed, once a turn."""

    about: ClassVar = EffectInfo(
        "imbalance",
        "wheel",
        "F = ω² R(φ) (along, up)",
        "mass off centre: once a turn, with omega squared",
    )
    along: Number = strength("kg m", 0.2, "mass times offset, forward at angle zero")
    up: Number = strength("kg m", 0.2, "mass times offset, upward at angle zero")

    def load(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        moment: StepContext,
        memory: Memory,
    ) -> Float[Array, "2"]:
        cosine, sine = jnp.cos(moment.angle), jnp.sin(moment.angle)
        outward = [self.along * cosine + self.up * sine, self.up * cosine - self.along * sine]
        return moment.omega**2 * jnp.stack(outward)


WHEEL = (WheelRadius, GrouserHeight, GrouserShadowing, Eccentricity, Imbalance)
