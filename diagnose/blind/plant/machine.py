"""Wheel and rig of the plant: loads, friction, springs and wheel faults."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.sand import number
from drftjax.effects.base import (
    AbstractPlacement,
    Memory,
    MemorylessLoad,
    StepContext,
    along_x,
    along_z,
)
from drftjax.physics.wheel import Plates

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Farthest place behind the start at which the stiffness of a cable still changes [m].
CABLE_BEND_LIMIT = -0.25


def stribeck(speed: Number, stick: Number, surplus: Number) -> Number:
    r"""Dry friction with a Stribeck peak, $(1 + a\,e^{-(v/5s)^2}) \tanh(v/s)$, for unit force.

    Args:
        speed: Sliding speed v [m/s].
        stick: Width s of the regularised step at rest [m/s].
        surplus: Relative height a of the peak [-].
    """
    return (1 + surplus * jnp.exp(-((speed / (5 * stick)) ** 2))) * jnp.tanh(speed / stick)


def power_drag(speed: Number, reference: float, power: Number) -> Number:
    r"""Drag $v\,|v/v_0|^{p-1}$ for unit damping.

    Args:
        speed: Speed v [m/s].
        reference: Speed $v_0$ at which the drag is that of a linear damper [m/s].
        power: Exponent p [-].

    Returns:
        Drag per damping [m/s].
    """
    return speed * ((speed**2 + 1e-8) / reference**2) ** ((power - 1) / 2)


class PlantVerticalLoad(MemorylessLoad):
    """Constant vertical load `force` [N], positive downward."""

    force: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force)


class PlantVerticalCoulomb(MemorylessLoad):
    """Dry friction `force` [N] of the vertical guide, by `stribeck`."""

    force: Number = number()
    stick: Number = number(1e-4)
    surplus: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force * stribeck(velocity[1], self.stick, self.surplus))


class PlantVerticalViscous(MemorylessLoad):
    """Drag of the vertical guide, `damping` [N s/m] at 2 mm/s, by `power_drag`."""

    damping: Number = number()
    power: Number = number(1.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.damping * power_drag(velocity[1], 2e-3, self.power))


class PlantHorizontalCoulomb(MemorylessLoad):
    """Dry friction `force` [N] of the carriage, by `stribeck`."""

    force: Number = number()
    stick: Number = number(1e-3)
    surplus: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force * stribeck(velocity[0], self.stick, self.surplus))


class PlantHorizontalViscous(MemorylessLoad):
    """Drag of the carriage, `damping` [N s/m] at 0.1 m/s, by `power_drag`."""

    damping: Number = number()
    power: Number = number(1.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.damping * power_drag(velocity[0], 0.1, self.power))


class PlantDrawbar(MemorylessLoad):
    """Constant horizontal load `force` [N], positive against forward travel."""

    force: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force)


class PlantCableSpring(MemorylessLoad):
    r"""Cable force $-k\,x\,(1 + b \max(x, -0.25\,\mathrm{m}))$; every run starts at x = 0.

    The cable lies ahead of the carriage, so its stiffness is constant once the carriage is behind
    the start.

    Attributes:
        stiffness: Stiffness k at the start [N/m].
        bend: Relative increase b of the stiffness per metre of travel [1/m].
    """

    stiffness: Number = number()
    bend: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        stiffening = 1 + self.bend * jnp.maximum(position[0], CABLE_BEND_LIMIT)
        return along_x(-self.stiffness * position[0] * stiffening)


class PlantVerticalSpring(MemorylessLoad):
    """Vertical spring that stiffens with sinkage.

    Attributes:
        stiffness: Stiffness at zero sinkage [N/m].
        bend: Relative increase of the stiffness per 20 mm of sinkage [-].
    """

    stiffness: Number = number()
    bend: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        sinkage = -position[1]
        return along_z(self.stiffness * sinkage * (1 + self.bend * sinkage / 0.02))


class PlantImbalance(MemorylessLoad):
    """Centrifugal force of an eccentric mass.

    Attributes:
        moment_of_mass: Mass times its distance from the axle [kg m].
        phase: Angle of the mass at the start, from the direction of travel [rad].
    """

    moment_of_mass: Number = number()
    phase: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        outward = self.moment_of_mass * moment.omega**2
        angle = moment.angle - self.phase
        return outward * jnp.stack([jnp.cos(angle), -jnp.sin(angle)])


RIG_EFFECTS = (
    PlantVerticalLoad,
    PlantVerticalCoulomb,
    PlantVerticalViscous,
    PlantHorizontalCoulomb,
    PlantHorizontalViscous,
    PlantDrawbar,
    PlantCableSpring,
    PlantVerticalSpring,
    PlantImbalance,
)


class PlantEccentricity(AbstractPlacement):
    """Wheel centre displaced from the axle.

    Attributes:
        offset: Distance of the centre from the axle [m].
        phase: Angle of the centre at the start, from the direction of travel [rad].
    """

    offset: Number = number()
    phase: Number = number()

    def place(self, plates: Plates, angle: Number) -> Plates:
        centre_angle = angle - self.phase
        x = self.offset * jnp.cos(centre_angle)
        z = -self.offset * jnp.sin(centre_angle)
        return dataclasses.replace(plates, x=plates.x + x, z=plates.z + z)


class PlantGrouserShadowing(AbstractPlacement):
    r"""Sand between grousers moves along: the inner part of their faces carries little.

    At the share u of a grouser's height, faces carry $1 - e^{-(u/s)^p}$. Rim and tips carry as
    before.

    Attributes:
        share: Inner share s of the height that carries little [-].
        power: Exponent p: steepness of the boundary [-].
        radius, height: Rim radius and grouser height [m].
    """

    share: Number = number()
    power: Number = number(2.0)
    radius: Number = number(0.150)
    height: Number = number(0.018)

    def place(self, plates: Plates, angle: Number) -> Plates:
        distance = jnp.hypot(plates.x, plates.z)
        outward = (plates.x * plates.normal_x + plates.z * plates.normal_z) / distance
        up = jnp.maximum((distance - self.radius) / self.height, 1e-3)
        shaded = jnp.exp(-((up / jnp.maximum(self.share, 1e-6)) ** self.power))
        # Faces stand along the radius; rim and tips across it.
        carries = jnp.where(jnp.abs(outward) < 0.5, 1 - shaded, 1)
        return dataclasses.replace(plates, area=plates.area * carries)


WHEEL_EFFECTS = (PlantEccentricity,)
SHADOW_EFFECTS = (PlantGrouserShadowing,)
