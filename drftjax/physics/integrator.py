"""Linearisations of the sand's force in the velocity: the choice that makes rest stable.

A step solves (m - dt A) dv = dt F(v) for the change of velocity dv. Any A gives a first-order
scheme; A decides what happens where the force turns over, within `REST_SPEED` of rest.
`docs/theory/integrator.md` has the study that the default step was chosen from.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.physics.implicit import NewtonSettings
from drftjax.physics.stress import REST_SPEED

DEFAULT_STEP = 5e-4


# Steps that divide a row of 10 ms evenly [s].
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)


# A step may change the rim's speed by this share of the regulariser's width and no more: beyond,
# plates near rest are thrown across it at every step, and derivatives grow without bound.
LARGEST_CHANGE = 0.75


Wrench = Callable[[Float[Array, "2"], Float[Array, "2"]], Float[Array, "3"]]


class AbstractIntegrator(eqx.Module):
    """Linearises the wrench (fx, fz, torque) of the sand in the axle's velocity."""

    @abc.abstractmethod
    def linearise(
        self, wrench: Wrench, velocity: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
        """Value at `velocity` [m/s] and the matrix A by velocity.

        Args:
            wrench: Function of velocity and pace (see `plate_motion`).
            velocity: Where to linearise.
        """

    def rest_speed(
        self, radius: Float[Array, ""], gravity: Float[Array, ""], omega: Float[Array, ""]
    ) -> Float[Array, ""] | float:
        """Width [m/s] over which a plate's direction and the leading-plate rule fade in at rest.

        Args:
            radius: Rim radius [m].
            gravity: Gravitational acceleration [m/s2].
            omega: Angular velocity [rad/s].
        """
        del radius, gravity, omega
        return REST_SPEED


def value_and_jacobian(
    function: Callable[[Float[Array, "2"]], Float[Array, " n"]], at: Float[Array, "2"]
) -> tuple[Float[Array, " n"], Float[Array, "n 2"]]:
    """A function of the velocity [m/s], and its exact derivative there."""
    value, along = jax.linearize(function, at)
    # One direction at a time: a batched pair keeps XLA from fusing it with the plates' other sums.
    directions = jnp.eye(2, dtype=at.dtype)
    return value, jnp.stack([along(directions[0]), along(directions[1])], axis=1)


class Rosenbrock(AbstractIntegrator):
    """The exact derivative: linearly implicit Euler. It follows smooth motion most closely."""

    def linearise(
        self, wrench: Wrench, velocity: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
        return value_and_jacobian(lambda v: wrench(v, v), velocity)


class HeldPace(AbstractIntegrator):
    """The derivative at held speeds of the plates near rest: it comes to rest without chatter.

    Directions are p / |p|. Under `HELD_SPEED` only p is moved along and |p| stays: where a plate
    stops, the exact derivative does not see the force turn over and overshoots; this does not.
    Faster plates have the exact derivative, so smooth motion is as accurate as with `Rosenbrock`,
    and a wheel that is dropped still needs a step as short as its.
    """

    def linearise(
        self, wrench: Wrench, velocity: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
        return value_and_jacobian(lambda v: wrench(v, velocity), velocity)


class Explicit(AbstractIntegrator):
    """No derivative: semi-implicit Euler, for comparison. It chatters at rest."""

    def linearise(
        self, wrench: Wrench, velocity: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
        value = wrench(velocity, velocity)
        return value, jnp.zeros((3, 2), velocity.dtype)


class Implicit(AbstractIntegrator):
    """Implicit Euler: the velocity at the step's end balances the forces at the step's end.

    The width at rest goes with the speed of the rim, so that the quasi-static law stays free of
    rate, and is next to nothing where the wheel stands: it creeps by a twentieth of a millimetre a
    minute.

    Attributes:
        newton: Numbers of the search for the root.
        standing: Width at rest of a wheel that does not turn, over sqrt(r g) [-]: 0.6 um/s for the
            paper's wheel.
        rolling: Width at rest per speed of the rim [-]: plates within this part of the radius from
            the centre of rotation, far less than a plate is long.
    """

    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)
    standing: float = eqx.field(static=True, default=5e-7)
    rolling: float = eqx.field(static=True, default=1e-3)

    def linearise(
        self, wrench: Wrench, velocity: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
        return value_and_jacobian(lambda v: wrench(v, v), velocity)

    def rest_speed(
        self, radius: Float[Array, ""], gravity: Float[Array, ""], omega: Float[Array, ""]
    ) -> Float[Array, ""]:
        return self.standing * jnp.sqrt(radius * gravity) + self.rolling * radius * jnp.abs(omega)


def sharpest_ramp(radius: float) -> float:
    """The largest angular acceleration [rad/s2] that the shortest of `STEPS` follows steadily.

    Args:
        radius: Rim radius [m].
    """
    return LARGEST_CHANGE * REST_SPEED / (STEPS[-1] * radius)


def steady_step(radius: float, time: np.ndarray, omega: np.ndarray) -> float:
    """The longest step [s] at which `HeldPace` keeps its derivatives bounded on a command.

    Args:
        radius: Rim radius [m].
        time, omega: Knots of the command [s], [rad/s].
    """
    acceleration = radius * float(np.abs(np.diff(omega) / np.diff(time)).max())
    longest = LARGEST_CHANGE * REST_SPEED / max(acceleration, 1e-12)
    return next((step for step in STEPS if step <= longest), STEPS[-1])
