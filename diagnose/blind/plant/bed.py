"""The plant's bed: stress that follows depth and speed otherwise, a surface that is not flat."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.random_profiles import RandomCurve, flat_curve
from diagnose.blind.plant.sand import number
from drftjax.effects.base import (
    AbstractStressFactor,
    AbstractSurface,
    Memory,
    MemorylessSurface,
    StepContext,
)
from drftjax.physics.stress import PlateMotion

Number = Float[Array, ""]


Each = Float[Array, " plates"]


# Depth [m] above which stress is so small that its factor is of no account.
SKIN = 2e-4


class PlantRateHardening(AbstractStressFactor):
    """Stress grows by a power of plate speed; `excess` is that at 0.1 m/s."""

    excess: Number = number()
    power: Number = number(0.5)

    def factor(self, motion: PlateMotion) -> Each:
        square = motion.velocity_x**2 + motion.velocity_z**2 + 1e-10
        return 1 + self.excess * (square / 0.01) ** (self.power / 2)


class PlantDepthHardening(AbstractStressFactor):
    """Stress by a power 1 + `power` of depth, unchanged at 20 mm."""

    power: Number = number()

    def factor(self, motion: PlateMotion) -> Each:
        return (jnp.maximum(motion.depth, SKIN) / 0.02) ** self.power


class PlantRigidFloor(AbstractStressFactor):
    """Stress grows exponentially below the floor's depth, e-fold in `scale` [m]."""

    excess: Number = number()
    floor: Number = number(0.035)
    scale: Number = number(0.01)

    def factor(self, motion: PlateMotion) -> Each:
        below = jnp.clip((motion.depth - self.floor) / self.scale, 0, 5)
        return 1 + self.excess * jnp.expm1(below)


class PlantCohesion(AbstractStressFactor):
    """A stress as of a further depth [m], that sets in within `onset` [m] of the surface."""

    depth: Number = number()
    onset: Number = number(0.003)

    def factor(self, motion: PlateMotion) -> Each:
        depth = jnp.maximum(motion.depth, SKIN)
        return 1 + self.depth * (1 - jnp.exp(-((depth / self.onset) ** 2))) / depth


STRESS = (PlantRateHardening, PlantDepthHardening, PlantRigidFloor, PlantCohesion)


class PlantSurfaceProfile(MemorylessSurface):
    """Heights along a curve, each plate over its own."""

    amplitude: Number = number()
    curve: RandomCurve = eqx.field(default_factory=flat_curve)

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        return self.amplitude * self.curve(axle + ahead)


class PlantSurfaceSlope(MemorylessSurface):
    """An incline that bends a little: `bend` [1/m] of its slope a metre."""

    slope: Number = number()
    bend: Number = number()

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        x = axle + ahead
        return self.slope * x * (1 + self.bend * x / 2)


class PlantExcavation(AbstractSurface):
    """Slip digs, ever less: by `rate` at first, as a power of slip distance over `length` [m]."""

    rate: Number = number()
    length: Number = number(0.2)
    power: Number = number(0.5)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.rate)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory + moment.dt * jnp.abs(moment.rim_slip())

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        dug = ((1 + memory / self.length) ** self.power - 1) / self.power
        return jnp.full_like(ahead, -1) * self.rate * self.length * dug


GROUND = (PlantSurfaceProfile, PlantSurfaceSlope, PlantExcavation)
