"""Maps between a bounded number and the unbounded coordinate that a solver moves."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class AbstractBijector(eqx.Module):
    """A smooth, increasing map from the real line onto the values that a parameter may take."""

    @abc.abstractmethod
    def value(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the parameter's value at a coordinate of the solver."""

    @abc.abstractmethod
    def coordinate(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the coordinate of a value strictly inside the bounds."""

    def slope(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Return the derivative of the value by the coordinate, which scales standard errors."""
        return jax.jvp(self.value, (coordinate,), (jnp.ones_like(coordinate),))[1]


class Positive(AbstractBijector):
    r"""Positive values, $\exp u$: steps of the coordinate u are relative changes."""

    def value(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return jnp.exp(coordinate)

    def coordinate(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return jnp.log(value)


class Scaled(AbstractBijector):
    """Any value, in units of `scale`.

    Attributes:
        scale: A typical change of the value, in its unit.
    """

    scale: float

    def value(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return self.scale * coordinate

    def coordinate(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return value / self.scale


class Interval(AbstractBijector):
    r"""Values between `low` and `high`: low + (high - low) / (1 + $e^{-u}$).

    Attributes:
        low, high: Bounds, in the value's unit.
    """

    low: float
    high: float

    def value(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return self.low + (self.high - self.low) * jax.nn.sigmoid(coordinate)

    def coordinate(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        share = (value - self.low) / (self.high - self.low)
        return jnp.log(share) - jnp.log1p(-share)
