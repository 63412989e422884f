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
