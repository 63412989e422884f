"""Terrain: a surface that is not level, or does not stay so."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.effects.stage import (
    About,
    AbstractSurface,
    Memory,
    Moment,
    shape,
    strength,
)

Number = Float[Array, ""]
Each = Float[Array, " plates"]


# Polynomials in y² for cos y and (sin y) / y, y up to an eighth of a turn: right to 2e-7 of a
# wave's height.
TERMS = 4
_square = (np.pi / 4) ** 2 * (1 + np.polynomial.chebyshev.chebpts1(TERMS)) / 2
_root = np.sqrt(_square)
COSINE = np.polynomial.polynomial.polyfit(_square, np.cos(_root), TERMS - 1)
SINE = np.polynomial.polynomial.polyfit(_square, np.sin(_root) / _root, TERMS - 1)


@jax.custom_jvp
def _wave(turns: Each) -> tuple[Each, Each]:
    """cos(2π turns) - 1 and sin(2π turns), by polynomials and two doublings of the angle.

    The compiler calls its own sine for one plate after the other, which costs five plain steps;
    of polynomials it makes vectors.
    """
    quarter = jnp.pi / 2 * (turns - jnp.round(turns))
    square = quarter * quarter
    cosine = sine = jnp.zeros_like(quarter)
    for cosine_term, sine_term in zip(COSINE[::-1].tolist(), SINE[::-1].tolist(), strict=True):
        cosine = cosine * square + cosine_term
        sine = sine * square + sine_term
    sine = sine * quarter
    cosine, sine = 1 - 2 * sine * sine, 2 * sine * cosine
    return -2 * sine * sine, 2 * sine * cosine


@_wave.defjvp
def _wave_by_turns(primals: tuple[Each], tangents: tuple[Each]):
    cosine_less_one, sine = _wave(*primals)
    change = 2 * jnp.pi * tangents[0]
    return (cosine_less_one, sine), (-sine * change, (1 + cosine_less_one) * change)


class SurfaceProfile(AbstractSurface):
    """Height waves along x; the datum is the height at x = 0."""

    about: ClassVar = About(
        "surface_profile",
        "terrain",
        "h = cosine (cos(2π x / length) - 1) + sine sin(2π x / length)",
        "the surface is not flat: height waves in x",
    )
    cosine: Number = strength("m", 0.001, "amplitude in phase with x = 0")
    sine: Number = strength("m", 0.001, "amplitude a quarter wave on")
    length: Number = shape("m", 0.4, tuple(0.1 * 1.15**k for k in range(20)), "wavelength")

    def begin(self) -> Memory:
        return ()

    def advance(self, memory: Memory, moment: Moment) -> Memory:
        return ()

    def height(self, x: Each, memory: Memory) -> Each:
        cosine_less_one, sine = _wave(x * (1 / self.length))
        return self.cosine * cosine_less_one + self.sine * sine


class SurfaceSlope(AbstractSurface):
    """The surface is inclined."""

    about: ClassVar = About("surface_slope", "terrain", "h = slope x", "the surface is inclined")
    slope: Number = strength("-", 0.01, "rise of the surface along x")

    def begin(self) -> Memory:
        return ()

    def advance(self, memory: Memory, moment: Moment) -> Memory:
        return ()

    def height(self, x: Each, memory: Memory) -> Each:
        return self.slope * x


class Excavation(AbstractSurface):
    """Slip digs: the surface under the wheel goes down with slip distance."""

    about: ClassVar = About(
        "excavation",
        "terrain",
        "h = -rate ∫ |r ω - v_x| dt",
        "slip digs: the surface under the wheel goes down with slip distance",
    )
    rate: Number = strength("-", 0.1, "depth dug per slip distance", least=0.0)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.rate)

    def advance(self, memory: Memory, moment: Moment) -> Memory:
        return memory + moment.dt * jnp.abs(moment.rim_slip())

    def height(self, x: Each, memory: Memory) -> Each:
        return jnp.broadcast_to(-self.rate * memory, x.shape)


SURFACE = (SurfaceProfile, SurfaceSlope, Excavation)
