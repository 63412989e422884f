"""Single-wheel rig: masses, damping, loads, and the motion of the carriage under a force."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real, require_between
from drftjax.physics.command import Command


class AbstractCarriage(eqx.Module):
    """Horizontal axis, which sets vx."""

    @abc.abstractmethod
    def approach(self, velocity: Float[Array, "2"], command: Command) -> Float[Array, "2"]:
        """Velocity [m/s] that a step starts from: of a driven carriage, the speed commanded."""

    @abc.abstractmethod
    def impose(self, velocity: Float[Array, "2"], given: Float[Array, "2"]) -> Float[Array, "2"]:
        """The velocity [m/s], along an axis that is driven that of `given`."""

    @abc.abstractmethod
    def advance(
        self,
        velocity: Float[Array, "2"],
        impulse: Float[Array, "2"],
        inertia: Float[Array, "2 2"],
    ) -> Float[Array, "2"]:
        """Velocity [m/s] after the step, from `inertia` @ change = `impulse` where x is free."""


class FreeCarriage(AbstractCarriage):
    """The carriage rolls freely: x follows from the forces."""

    def approach(self, velocity: Float[Array, "2"], command: Command) -> Float[Array, "2"]:
        return velocity

    def impose(self, velocity: Float[Array, "2"], given: Float[Array, "2"]) -> Float[Array, "2"]:
        return velocity

    def advance(
        self,
        velocity: Float[Array, "2"],
        impulse: Float[Array, "2"],
        inertia: Float[Array, "2 2"],
    ) -> Float[Array, "2"]:
        # Written out: a solver call for 2x2 costs more than the whole step.
        (a, b), (c, d) = inertia
        determinant = a * d - b * c
        return velocity + jnp.stack(
            [
                (d * impulse[0] - b * impulse[1]) / determinant,
                (a * impulse[1] - c * impulse[0]) / determinant,
            ]
        )


class DrivenCarriage(AbstractCarriage):
    """The carriage is driven at the commanded vx: slip is imposed, fx follows.

    Attributes:
        ratio: Its speed over the commanded one [-].
    """

    ratio: Float[Array, ""] = eqx.field(converter=as_real, default=1.0)

    def approach(self, velocity: Float[Array, "2"], command: Command) -> Float[Array, "2"]:
        return jnp.stack([(self.ratio * command.vx).astype(velocity.dtype), velocity[1]])

    def impose(self, velocity: Float[Array, "2"], given: Float[Array, "2"]) -> Float[Array, "2"]:
        return jnp.stack([given[0], velocity[1]])

    def advance(
        self,
        velocity: Float[Array, "2"],
        impulse: Float[Array, "2"],
        inertia: Float[Array, "2 2"],
    ) -> Float[Array, "2"]:
        return velocity.at[1].add(impulse[1] / inertia[1, 1])


class Rig(eqx.Module):
    """Masses, damping and loads on the wheel; the default is Table 1 of Fuke et al. 2024.

    Attributes:
        mass_x: Mass that moves horizontally [kg].
        mass_z: Mass that moves vertically [kg].
        damping_x, damping_z: Damping terms c_x, c_z [N s/m].
        drawbar_load: Constant horizontal force held against the wheel, positive backward [N].
        gravity: Gravitational acceleration [m/s2].
        carriage: Free, or driven at a given vx(t).
    """

    mass_x: Float[Array, ""] = eqx.field(converter=as_real, default=13.902)
    mass_z: Float[Array, ""] = eqx.field(converter=as_real, default=18.837)
    damping_x: Float[Array, ""] = eqx.field(converter=as_real, default=0.0)
    damping_z: Float[Array, ""] = eqx.field(converter=as_real, default=0.0)
    drawbar_load: Float[Array, ""] = eqx.field(converter=as_real, default=0.0)
    gravity: Float[Array, ""] = eqx.field(converter=as_real, default=9.81)
    carriage: AbstractCarriage = eqx.field(default_factory=FreeCarriage)

    def __check_init__(self):
        require_between("mass_x", self.mass_x, 1e-3, 1e4, " kg")
        require_between("mass_z", self.mass_z, 1e-3, 1e4, " kg")
        require_between("damping_x", self.damping_x, 0.0, 1e6, " N s/m")
        require_between("damping_z", self.damping_z, 0.0, 1e6, " N s/m")
        require_between("drawbar load", self.drawbar_load, -1e5, 1e5, " N")
        require_between("gravity", self.gravity, 0.1, 100.0, " m/s2")

    def mass(self) -> Float[Array, "2"]:
        """Masses (x, z) [kg]."""
        return jnp.stack([self.mass_x, self.mass_z])

    def load(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        """Force (x, z) of the rig on the wheel [N]: weight, drawbar load and damping."""
        return jnp.stack(
            [
                -self.drawbar_load - self.damping_x * velocity[0],
                -self.mass_z * self.gravity - self.damping_z * velocity[1],
            ]
        )
