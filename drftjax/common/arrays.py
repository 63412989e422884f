"""How numbers enter the simulator: as floating arrays that JAX can trace and differentiate."""

import jax
import jax.core as jax_core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.errors import InputError

# One number, written or computed.
Real = float | Array


def as_real(value: ArrayLike) -> Float[Array, "..."]:
    """A floating array in JAX's current default precision; tracers and floating arrays pass."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return value
    return jnp.asarray(value, dtype=float)


def require_between(name: str, value: ArrayLike, low: float, high: Real, hint: str = "") -> None:
    """Refuse a concrete number outside [low, high] or not finite; traced ones pass.

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
    try:
        return given.astype(float)
    except OverflowError:
        return np.full(given.shape, np.inf)
