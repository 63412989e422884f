"""Shapes along x that several effects share: one place of some width, and waves."""

import math
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import shape

Number = Float[Array, ""]


def centre(of_what: str) -> Any:
    """A field: the place of something along x [m]; its starts lie ahead of x = 0."""
    starts = tuple(0.1 * k for k in range(1, 16))
    meaning = f"place of the {of_what}, below 0 behind x = 0"
    return shape("m", 0.5, starts, meaning, least=-math.inf)


def width(meaning: str = "its standard deviation along x") -> Any:
    """Field: width of the effect along x [m]."""
    return shape("m", 0.15, (0.05, 0.1, 0.2, 0.4), meaning)


def wavelength() -> Any:
    """A field: the length of waves along x [m]."""
    return shape("m", 0.4, tuple(0.1 * 1.15**k for k in range(20)), "wavelength")


def one_wavelength(*starts: float) -> Any:
    """A field: the length of one of several waves along x [m], by the middle of its starts."""
    return shape("m", starts[len(starts) // 2], starts, "wavelength of one of the waves")


def wave(cosine: Number, sine: Number, length: Number, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """A wave of a length [m] at some places along x [m], in the unit of its amplitudes.

    Args:
        cosine, sine: Amplitudes in phase with x = 0, and a quarter wave on.
        length: Wavelength [m].
        x: Places [m], shape (*n,).
    """
    turn = 2 * jnp.pi / length * x
    return cosine * jnp.cos(turn) + sine * jnp.sin(turn)


def bell(x: Number, centre: Number, width: Number) -> Number:
    """A normal curve that is one at its centre; all in metres."""
    away = (x - centre) / width
    return jnp.exp(-(away**2) / 2)
