"""Conversion of numbers to floating arrays that JAX can trace, and checks of their range."""

import jax
import jax.core as jax_core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.errors import InputError

Real = float | Array
"""One real number, plain or computed by JAX."""


def as_real(value: ArrayLike) -> Float[Array, "..."]:
    """Convert a value to a floating array of JAX's default precision.

    Args:
        value: Numbers of any shape; a JAX array or tracer of a floating type is returned unchanged.

    Returns:
        Array of the same shape.
    """
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    return jnp.asarray(value, dtype=float)


def require_between(name: str, value: ArrayLike, low: float, high: Real, hint: str = "") -> None:
    """Refuse a number that is not finite or lies outside [low, high].

    Args:
        name: Name of the quantity in the error message.
        value: Numbers of any shape; a traced value passes, as it has no number yet.
        low: Smallest value allowed.
        high: Largest value allowed; where it is traced, nothing is checked.
        hint: Text added to the message, such as a unit.

    Raises:
        InputError: names the quantity, what was given and what must hold.
    """
    if isinstance(value, jax_core.Tracer) or isinstance(high, jax_core.Tracer):
        return
    high = float(high)
    given = np.asarray(value)
    if given.dtype == object:  # whole numbers beyond 64 bits
        given = _as_floats(given)
    if not np.all(np.isfinite(given)) or np.any(given < low) or np.any(given > high):
        shown = f"{float(given):g}" if given.ndim == 0 else f"{given.tolist()}"
        raise InputError(f"{name} is {shown}, must lie between {low:g} and {high:g}{hint}")


def _as_floats(given: np.ndarray) -> np.ndarray:
    """Whole numbers of any size as float64; infinite where one is too large."""
    try:
        return given.astype(float)
    except OverflowError:
        return np.full(given.shape, np.inf)
