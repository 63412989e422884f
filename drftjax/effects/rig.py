"""Rig: forces of guides, counterweights, cables and springs on the axle."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import (
    AbstractLoad,
    EffectInfo,
    Memory,
    MemorylessLoad,
    StepContext,
    along_x,
    along_z,
    shape,
    strength,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Regularisers: speeds [m/s] over which dry friction turns over. The vertical guide moves by tenths
# of a millimetre a second, the carriage by centimetres.
VERTICAL_STICK = 1e-4


# Speeds over which a guide's breakaway friction fades, in those over which friction turns over [-].
BREAKAWAY_RANGE = 5.0


HORIZONTAL_STICK = 1e-3


class VerticalLoad(MemorylessLoad):
    """A constant vertical force."""

    about: ClassVar = EffectInfo(
        "vertical_load", "rig", "F_z = -force", "a constant vertical force or mass error"
    )
    force: Number = strength("N", 10.0, "further load, downward positive")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force)


class VerticalCoulomb(MemorylessLoad):
    """Dry friction of the vertical guide."""

    about: ClassVar = EffectInfo(
        "vertical_coulomb",
        "rig",
        "F_z = -force tanh(v_z / 0.1 mm/s)",
        "dry friction of the vertical guide",
    )
    force: Number = strength("N", 5.0, "friction", least=0.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.force * jnp.tanh(velocity[1] / VERTICAL_STICK))


class VerticalCreepFriction(MemorylessLoad):
    """Dry friction of a vertical guide that creeps before it slides, and breaks away from more.

    Slow sliding takes the more force by Tustin's law, a form of Stribeck's curve (Armstrong et al.
    1994, "A survey of models, analysis tools and compensation methods for the control of machines
    with friction", Automatica 30).
    """

    about: ClassVar = EffectInfo(
        "vertical_creep_friction",
        "rig",
        "F_z = -(force + breakaway exp(-|v_z| / (5 creep))) tanh(v_z / creep)",
        "dry friction of a vertical guide that creeps before it slides, and breaks away from more",
        form_of="vertical_coulomb",
    )
    force: Number = strength("N", 5.0, "friction", least=0.0)
    breakaway: Number = strength("N", 2.0, "further friction of slow sliding", least=0.0)
    creep: Number = shape("m/s", 3e-4, (3e-4, 1e-3), "speed over which the friction turns over")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        relative = velocity[1] / self.creep
        further = self.breakaway * jnp.exp(-jnp.abs(relative) / BREAKAWAY_RANGE)
        return along_z(-(self.force + further) * jnp.tanh(relative))


class VerticalViscous(MemorylessLoad):
    """Viscous friction of the vertical guide."""

    about: ClassVar = EffectInfo(
        "vertical_viscous", "rig", "F_z = -damping v_z", "viscous friction of the vertical guide"
    )
    damping: Number = strength("N s/m", 1000.0, "friction per speed", least=0.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.damping * velocity[1])


class HorizontalCoulomb(MemorylessLoad):
    """Dry friction of the carriage."""

    about: ClassVar = EffectInfo(
        "horizontal_coulomb",
        "rig",
        "F_x = -force tanh(v_x / 1 mm/s)",
        "dry friction of the carriage",
    )
    force: Number = strength("N", 3.0, "friction", least=0.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force * jnp.tanh(velocity[0] / HORIZONTAL_STICK))


class HorizontalViscous(MemorylessLoad):
    """Viscous friction of the carriage."""

    about: ClassVar = EffectInfo(
        "horizontal_viscous", "rig", "F_x = -damping v_x", "viscous friction of the carriage"
    )
    damping: Number = strength("N s/m", 30.0, "friction per speed", least=0.0)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.damping * velocity[0])


class Drawbar(MemorylessLoad):
    """A constant horizontal force."""

    about: ClassVar = EffectInfo(
        "drawbar",
        "rig",
        "F_x = -force",
        "a constant horizontal force: rail tilt, cable weight",
    )
    force: Number = strength("N", 5.0, "pull against the forward direction")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.force)


class CableSpring(AbstractLoad):
    """A horizontal force that grows with travel."""

    about: ClassVar = EffectInfo(
        "cable_spring",
        "rig",
        "F_x = -stiffness (x - x(0))",
        "a horizontal force proportional to travel",
    )
    stiffness: Number = strength("N/m", 5.0, "force per travel, against the forward direction")

    def begin(self, position: Pair) -> Memory:
        return position[0]

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_x(-self.stiffness * (position[0] - memory))


class VerticalSpring(AbstractLoad):
    """A vertical force that grows with sinkage from where the wheel stood at the start."""

    about: ClassVar = EffectInfo(
        "vertical_spring",
        "rig",
        "F_z = stiffness (H - H(0))",
        "a vertical force proportional to sinkage",
    )
    stiffness: Number = strength("N/m", 500.0, "upward force per sinkage")

    def begin(self, position: Pair) -> Memory:
        return position[1]

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.stiffness * (position[1] - memory))


class SurfaceSpring(MemorylessLoad):
    """A vertical force that grows with sinkage from the undisturbed surface."""

    about: ClassVar = EffectInfo(
        "surface_spring",
        "rig",
        "F_z = stiffness H",
        "a vertical force proportional to sinkage, none at the undisturbed surface",
        form_of="vertical_spring",
    )
    stiffness: Number = strength("N/m", 500.0, "upward force per sinkage")

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(-self.stiffness * position[1])


RIG = (
    VerticalLoad,
    VerticalCoulomb,
    VerticalCreepFriction,
    VerticalViscous,
    HorizontalCoulomb,
    HorizontalViscous,
    Drawbar,
    CableSpring,
    VerticalSpring,
    SurfaceSpring,
)
