r"""Frame of the sand's surface, in which its stress is worked out.

The theory knows a flat level surface. On a plane that rises along x by $\tan\theta$, the wheel is
turned by $-\theta$ onto level sand: positions, normals and velocities are those along the plane
and along its normal, depth is the distance from the plane, and the stress is turned back.

$$\mathbf a' = \begin{pmatrix}\cos\theta & \sin\theta\\ -\sin\theta & \cos\theta\end{pmatrix}
  \mathbf a$$

Gravity is not turned: it pulls at the wheel, and stays vertical.
"""

import abc
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.physics.wheel import Plates

Number = Float[Array, ""]
Each = Float[Array, " plates"]


class AbstractSurfaceFrame(eqx.Module):
    """Frame with one axis along the sand's surface and one along its normal."""

    @abc.abstractmethod
    def plates(self, plates: Plates) -> Plates:
        """The plates about the axle, in this frame."""

    @abc.abstractmethod
    def distance(self, height: Number) -> Number:
        """Distance of the axle from the surface [m], given its height over level sand [m]."""

    @abc.abstractmethod
    def velocity(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        """A velocity (x, z) [m/s], in this frame."""

    @abc.abstractmethod
    def stress_in_space(self, along: Each, normal: Each) -> tuple[Each, Each]:
        """Stress (x, z) on the plates [Pa], given that along the surface and along its normal."""


class LevelFrame(AbstractSurfaceFrame):
    """Frame of level sand, that of space."""

    def plates(self, plates: Plates) -> Plates:
        return plates

    def distance(self, height: Number) -> Number:
        return height

    def velocity(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        return velocity

    def stress_in_space(self, along: Each, normal: Each) -> tuple[Each, Each]:
        return along, normal


class InclinedFrame(AbstractSurfaceFrame):
    """Frame of a plane that rises along x.

    Attributes:
        height: Height of the plane under the axle over level sand [m].
        rise: Its slope along x, the tangent of its angle [-].
    """

    height: Number
    rise: Number

    def plates(self, plates: Plates) -> Plates:
        x, z = self._turn(plates.x, plates.z)
        normal_x, normal_z = self._turn(plates.normal_x, plates.normal_z)
        return replace(plates, x=x, z=z, normal_x=normal_x, normal_z=normal_z)

    def distance(self, height: Number) -> Number:
        return self._cosine() * (height - self.height)

    def velocity(self, velocity: Float[Array, "2"]) -> Float[Array, "2"]:
        return jnp.stack(self._turn(velocity[0], velocity[1]))

    def stress_in_space(self, along: Each, normal: Each) -> tuple[Each, Each]:
        cosine = self._cosine()
        sine = self.rise * cosine
        return cosine * along - sine * normal, sine * along + cosine * normal

    def _cosine(self) -> Number:
        return 1 / jnp.sqrt(1 + self.rise**2)

    def _turn(self, x: Array, z: Array) -> tuple[Array, Array]:
        cosine = self._cosine()
        sine = self.rise * cosine
        return cosine * x + sine * z, cosine * z - sine * x
