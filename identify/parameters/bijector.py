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
        """The parameter's value at a solver's coordinate."""

    @abc.abstractmethod
    def coordinate(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The coordinate of a value strictly inside the bounds."""

    def slope(self, coordinate: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Derivative of the value by the coordinate: carries an error from one to the other."""
        return jax.jvp(self.value, (coordinate,), (jnp.ones_like(coordinate),))[1]


class Positive(AbstractBijector):
    """Values over zero; coordinate steps are relative changes."""

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
    """Values between `low` and `high`.

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
