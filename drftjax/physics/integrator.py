"""Implicit Euler: how a step finds the velocity at its end, and how rest is represented.

`drftjax.physics.implicit` holds the search for the root and its derivatives;
`docs/theory/integrator.md` has the study behind the numbers.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.physics.implicit import NewtonSettings

# Step [s] of a simulation for which none is chosen (`drftjax.simulation.step_choice`).
DEFAULT_STEP = 2.5e-3


class ImplicitEuler(eqx.Module):
    """The velocity at a step's end balances the forces at the step's end.

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
    rolling: float = eqx.field(static=True, default=3e-3)

    def rest_speed(
        self, radius: Float[Array, ""], gravity: Float[Array, ""], omega: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Width [m/s] over which a plate's direction and the leading-plate rule fade in at rest.

        Args:
            radius: Rim radius [m].
            gravity: Gravitational acceleration [m/s2].
            omega: Angular velocity [rad/s].
        """
        return self.standing * jnp.sqrt(radius * gravity) + self.rolling * radius * jnp.abs(omega)

    def lead_speed(self, radius: Float[Array, ""], omega: Float[Array, ""]) -> Float[Array, ""]:
        """Speed [m/s] along its normal from which on a plate carries its whole load.

        Nothing on a wheel that stands, so that it holds. Half the width on one that rolls: what
        plates carry that just do not lead makes up for what those do not that just lead.

        Args:
            radius: Rim radius [m].
            omega: Angular velocity [rad/s].
        """
        return self.rolling * radius * jnp.abs(omega) / 2
