"""The plant's wheel and rig: masses, guides, cables and springs that are not quite textbook."""

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


# Place behind the start [m] from which on a cable has its least stiffness.
SLACK = -0.25


def stribeck(speed: Number, stick: Number, surplus: Number) -> Number:
    """Dry friction of force one: more of it, by `surplus`, within five times `stick` [m/s]."""
    return (1 + surplus * jnp.exp(-((speed / (5 * stick)) ** 2))) * jnp.tanh(speed / stick)


def drag(speed: Number, at: float, power: Number) -> Number:
    """Friction by a power of speed, the speed itself at `at` [m/s]."""
    return speed * ((speed**2 + 1e-8) / at**2) ** ((power - 1) / 2)


class PlantVerticalLoad(MemorylessLoad):
    force: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force)


class PlantVerticalCoulomb(MemorylessLoad):
    force: Number = number()
    stick: Number = number(1e-4)
    surplus: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force * stribeck(velocity[1], self.stick, self.surplus))


class PlantVerticalViscous(MemorylessLoad):
    damping: Number = number()
    power: Number = number(1.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.damping * drag(velocity[1], 2e-3, self.power))


class PlantHorizontalCoulomb(MemorylessLoad):
    force: Number = number()
    stick: Number = number(1e-3)
    surplus: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force * stribeck(velocity[0], self.stick, self.surplus))


class PlantHorizontalViscous(MemorylessLoad):
    damping: Number = number()
    power: Number = number(1.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.damping * drag(velocity[0], 0.1, self.power))


class PlantDrawbar(MemorylessLoad):
    force: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force)


class PlantCableSpring(MemorylessLoad):
    """A cable that stiffens by `bend` a metre of travel; every run starts at x = 0.

    It lies ahead, so that it bends no more once the carriage is behind the start.
    """

    stiffness: Number = number()
    bend: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        bent = 1 + self.bend * jnp.maximum(position[0], SLACK)
        return along_x(-self.stiffness * position[0] * bent)


class PlantVerticalSpring(MemorylessLoad):
    """A spring that stiffens by `bend` for 20 mm of sinkage."""

    stiffness: Number = number()
    bend: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        sinkage = -position[1]
        return along_z(self.stiffness * sinkage * (1 + self.bend * sinkage / 0.02))


class PlantImbalance(MemorylessLoad):
    """A mass [kg m] off the axle, at `phase` [rad] from straight ahead when the wheel starts."""

    moment_of_mass: Number = number()
    phase: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        outward = self.moment_of_mass * moment.omega**2
        turned = moment.angle - self.phase
        return outward * jnp.stack([jnp.cos(turned), -jnp.sin(turned)])


RIG = (
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
    """The centre lies `offset` [m] off the axle, at `phase` [rad] from straight ahead."""

    offset: Number = number()
    phase: Number = number()

    def place(self, plates: Plates, angle: Number) -> Plates:
        turned = angle - self.phase
        x = self.offset * jnp.cos(turned)
        z = -self.offset * jnp.sin(turned)
        return dataclasses.replace(plates, x=plates.x + x, z=plates.z + z)


WHEEL = (PlantEccentricity,)
