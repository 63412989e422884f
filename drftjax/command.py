"""What is asked of the rig over one step, and over a whole run."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Command(eqx.Module):
    """The command for one step; with a leading time axis, for a run.

    Attributes:
        omega: Angular velocity at the end of the step, positive driving forward [rad/s].
        vx: Carriage speed at the end of the step [m/s]; used where the carriage is driven.
        zeta: Scaling factor over the step [-]; used where the terrain takes it step by step.
    """

    omega: Float[Array, "*time"]
    vx: Float[Array, "*time"]
    zeta: Float[Array, "*time"]


def command_at(
    time: Float[Array, " steps"],
    command_time: Float[Array, " knots"],
    omega: Float[Array, " knots"],
    vx: Float[Array, " knots"] | None = None,
    zeta: Float[Array, " knots"] | None = None,
) -> Command:
    """A recorded command, linear between its samples and constant beyond them, at `time` [s]."""

    def at(values: Float[Array, " knots"] | None) -> Float[Array, " steps"]:
        if values is None:
            return jnp.zeros_like(time)
        return jnp.interp(time, command_time, values)

    return Command(omega=at(omega), vx=at(vx), zeta=at(zeta))
