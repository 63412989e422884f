"""Inputs of a linearised run: an unknown error in each stage of a step, constant over the step."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import (
    AbstractPlane,
    EffectInfo,
    Memory,
    MemorylessDrive,
    MemorylessLoad,
    MemorylessSurface,
    MemorylessZetaFactor,
    StepContext,
    strength,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


class ZetaError(MemorylessZetaFactor):
    """zeta multiplied by exp(error)."""

    about: ClassVar = EffectInfo(
        "zeta_error", "terrain", "ζ = ζ exp(error)", "an unknown zeta factor"
    )
    error: Number = strength("-", 0.1, "logarithm of the factor")

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.exp(self.error)


class ForceError(MemorylessLoad):
    """A force on the axle beside those of the model."""

    about: ClassVar = EffectInfo("force_error", "rig", "F = F + (x, z)", "an unknown force")
    x: Number = strength("N", 5.0, "horizontal force")
    z: Number = strength("N", 5.0, "vertical force")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return jnp.stack([self.x, self.z])


class SpeedError(MemorylessDrive):
    """A wheel speed that exceeds the commanded one."""

    about: ClassVar = EffectInfo(
        "speed_error", "drive", "ω = ω + error", "an unknown drive speed error"
    )
    error: Number = strength("rad/s", 0.02, "excess of the speed")

    def speed(self, omega: Number, angle: Number) -> Number:
        return omega + self.error


class HeightError(AbstractPlane, MemorylessSurface):
    """A surface that lies higher under the axle, and rises along x."""

    about: ClassVar = EffectInfo(
        "height_error", "terrain", "h = h + error + rise ahead", "an unknown surface height"
    )
    error: Number = strength("m", 0.001, "height of the surface under the axle")
    rise: Number = strength("-", 0.01, "rise of the surface along x")

    def plane(self, axle: Number, memory: Memory) -> tuple[Number, Number]:
        return self.error, self.rise


# Names of the inputs of a linearised run, in order.
INPUTS = ("zeta", "force_x", "force_z", "speed", "height", "rise")


def unknown_inputs(inputs: Float[Array, "6"]) -> tuple:
    """Effects that apply the inputs of a linearised run.

    Args:
        inputs: In the order of `INPUTS`: logarithm of a factor on zeta [-], horizontal and vertical
            force [N], speed [rad/s], height [m] and rise of the surface [-].
    """
    zeta, force_x, force_z, speed, height, rise = inputs
    return (
        SpeedError(error=speed),
        ZetaError(error=zeta),
        HeightError(error=height, rise=rise),
        ForceError(x=force_x, z=force_z),
    )
