"""Loads: what forces on the axle have in common, whoever adds them."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.stage import AbstractLoad, Memory, Moment


def along_x(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts forward."""
    return jnp.stack([force, jnp.zeros_like(force)])


def along_z(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts upward."""
    return jnp.stack([jnp.zeros_like(force), force])


class MemorylessLoad(AbstractLoad):
    """A load that depends on the present alone."""

    def begin(self, position: Float[Array, "2"]) -> Memory:
        return ()

    def advance(self, memory: Memory, moment: Moment) -> Memory:
        return ()
