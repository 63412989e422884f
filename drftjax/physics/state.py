"""State of the wheel, output of a step, and slip."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import Real, as_real


class State(eqx.Module):
    """State of the simulated wheel between two steps.

    Attributes:
        time: Time from the run's start [s].
        position: Axle position (x, z) [m]; z = 0 where the rim just touches the surface.
        velocity: Axle velocity (x, z) [m/s].
        angle: Wheel angle, positive driving forward [rad].
        omega: Angular velocity [rad/s].
        memory: Memory of each effect; empty before `Simulator.begin`.
        growth: Most that a derivative by the velocity has grown by since it last was as small as
            it began [-]; see `drftjax.physics.implicit`.
        trend: By how much more than its angular velocity says the wheel sped up in the last step,
            (x, z) [m/s2]; zero past a fold. The search for the next velocity begins with it.
    """

    time: Float[Array, ""]
    position: Float[Array, "2"]
    velocity: Float[Array, "2"]
    angle: Float[Array, ""]
    omega: Float[Array, ""]
    memory: tuple[Any, ...] = ()
    growth: Float[Array, ""] = eqx.field(converter=as_real, default=1.0)
    trend: Float[Array, "2"] = eqx.field(converter=as_real, default=(0.0, 0.0))

    @classmethod
    def at_rest(cls, sinkage: Real, x: Real = 0.0, angle: Real = 0.0, speed: Real = 0.0) -> "State":
        """A wheel that does not turn; its carriage may roll forward.

        Args:
            sinkage: H = -z [m].
            x: Place of the axle [m].
            angle: Wheel angle [rad].
            speed: Of the carriage [m/s].
        """
        depth = as_real(sinkage)
        nought = jnp.zeros((), depth.dtype)
        place = jnp.stack([nought + x, -depth])
        velocity = jnp.stack([nought + speed, nought])
        return cls(nought, place, velocity, nought + angle, nought)


class Output(eqx.Module):
    """Output of a step; with a leading time axis, of a run.

    Attributes:
        time: End of the step [s].
        x, z: Axle position [m].
        vx, vz: Axle velocity [m/s].
        angle: Wheel angle [rad].
        omega: Angular velocity [rad/s].
        fx, fz: Force of the sand on the wheel over the step [N].
        torque: Drive torque that balances the sand [N m].
        slip: 1 - vx / (r omega) [-]; 0 where the wheel does not turn.
        sinkage: H = -z [m].
        zeta: Scaling factor used [-].
    """

    time: Float[Array, "*time"]
    x: Float[Array, "*time"]
    z: Float[Array, "*time"]
    vx: Float[Array, "*time"]
    vz: Float[Array, "*time"]
    angle: Float[Array, "*time"]
    omega: Float[Array, "*time"]
    fx: Float[Array, "*time"]
    fz: Float[Array, "*time"]
    torque: Float[Array, "*time"]
    slip: Float[Array, "*time"]
    sinkage: Float[Array, "*time"]
    zeta: Float[Array, "*time"]


def slip(
    radius: Float[Array, ""], omega: Float[Array, ""], speed: Float[Array, ""]
) -> Float[Array, ""]:
    r"""Longitudinal slip $s = 1 - v / (r\omega)$ of a driven wheel.

    Args:
        radius: Rim radius [m].
        omega: Angular velocity, positive driving forward [rad/s].
        speed: Carriage speed [m/s].

    Returns:
        Slip ratio [-]; 0 rolls freely, 1 spins on the spot, 0 by convention at omega = 0.
    """
    turning = omega != 0
    return jnp.where(turning, 1 - speed / (radius * jnp.where(turning, omega, 1)), 0)
