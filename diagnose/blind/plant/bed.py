"""Bed of the plant: stress factors that depend on depth and speed, and an uneven surface.

Each class has the form of its effect in the catalogue changed, so that no candidate of a diagnosis
fits it exactly.
"""

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


# Least depth in a stress factor [m]; above it stress is so small that its factor has no effect.
MIN_DEPTH = 2e-4


class PlantRateHardening(AbstractStressFactor):
    r"""Stress factor $1 + e\,(v / 0.1\,\mathrm{m/s})^p$ of plate speed v.

    Attributes:
        excess: Relative increase e at 0.1 m/s [-].
        power: Exponent p [-].
    """

    excess: Number = number()
    power: Number = number(0.5)

    def factor(self, motion: PlateMotion) -> Each:
        square = motion.velocity_x**2 + motion.velocity_z**2 + 1e-10
        return 1 + self.excess * (square / 0.01) ** (self.power / 2)


class PlantDepthHardening(AbstractStressFactor):
    r"""Stress factor $(d / d_0)^p$ of depth d: stress by a power $1 + p$ of depth.

    Attributes:
        power: Exponent p [-].
        reference: Depth $d_0$ at which the factor is one [m].
    """

    power: Number = number()
    reference: Number = number(0.02)

    def factor(self, motion: PlateMotion) -> Each:
        return (jnp.maximum(motion.depth, MIN_DEPTH) / self.reference) ** self.power


class PlantRigidFloor(AbstractStressFactor):
    r"""Stress factor $1 + e\,(\exp((d - f)/s) - 1)$ below a floor, at most for five scales.

    Attributes:
        excess: Relative increase e [-].
        floor: Depth f of the floor [m].
        scale: Depth s in which the increase grows by a factor of e [m].
    """

    excess: Number = number()
    floor: Number = number(0.035)
    scale: Number = number(0.01)

    def factor(self, motion: PlateMotion) -> Each:
        below = jnp.clip((motion.depth - self.floor) / self.scale, 0, 5)
        return 1 + self.excess * jnp.expm1(below)


class PlantCohesion(AbstractStressFactor):
    r"""Stress as if each plate were deeper by `depth`, with a smooth onset at the surface.

    Attributes:
        depth: Additional depth [m].
        onset: Depth of the onset [m].
    """

    depth: Number = number()
    onset: Number = number(0.003)

    def factor(self, motion: PlateMotion) -> Each:
        depth = jnp.maximum(motion.depth, MIN_DEPTH)
        return 1 + self.depth * (1 - jnp.exp(-((depth / self.onset) ** 2))) / depth


STRESS_EFFECTS = (PlantRateHardening, PlantDepthHardening, PlantRigidFloor, PlantCohesion)


class PlantSurfaceProfile(MemorylessSurface):
    """Surface height along a random curve, at the place of each plate.

    Attributes:
        amplitude: Height of the curve's unit [m].
        curve: Curve along x [-].
    """

    amplitude: Number = number()
    curve: RandomCurve = eqx.field(default_factory=flat_curve)

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        return self.amplitude * self.curve(axle + ahead)


class PlantSurfaceSlope(MemorylessSurface):
    r"""Surface height $s\,x\,(1 + b x / 2)$ of a slope that changes with x.

    Attributes:
        slope: Slope s at the start [-].
        bend: Relative change b of the slope per metre [1/m].
    """

    slope: Number = number()
    bend: Number = number()

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        x = axle + ahead
        return self.slope * x * (1 + self.bend * x / 2)


class PlantExcavation(AbstractSurface):
    r"""Surface lowered by slip: by $r l\,((1 + q/l)^p - 1)/p$ after a slip distance q.

    Attributes:
        rate: Initial depth per slip distance r [-].
        length: Slip distance l over which the rate changes [m].
        power: Exponent p [-].
    """

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


class PlantSlipSinkage(AbstractSurface):
    r"""Surface lowered by slip through two stores of loose sand, the second fed by the first.

    Slip fills the first store, travel carries it over to the second and that one away, each over
    half the length l: $\dot q_1 = |s| - 2 |v_x| q_1 / l$, $\dot q_2 = 2 |v_x| (q_1 - q_2) / l$. The
    surface lies lower by $r (q_1 + q_2)$: at an even slip ratio i by $r\,l\,i / (1 - i)$.

    Attributes:
        rate: Depth per slip distance r [-].
        length: Travel l that leads to fresh sand [m].
    """

    rate: Number = number()
    length: Number = number(0.12)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.rate), jnp.zeros_like(self.rate)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        first, second = memory
        carried = moment.dt * 2 * jnp.abs(moment.velocity[0]) / self.length
        first = (first + moment.dt * jnp.abs(moment.rim_slip())) / (1 + carried)
        return first, (second + carried * first) / (1 + carried)

    def height(self, axle: Number, ahead: Each, memory: Memory) -> Each:
        first, second = memory
        return jnp.full_like(ahead, -1) * self.rate * (first + second)


SURFACE_EFFECTS = (PlantSurfaceProfile, PlantSurfaceSlope, PlantExcavation, PlantSlipSinkage)
