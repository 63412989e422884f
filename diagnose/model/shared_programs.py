"""One compiled program for all corrections of a stage while they are fitted.

A correction's knots and variable belong to its class, so that every curve would be compiled. In a
fit they are numbers: the program of a stage holds a row of knots, long enough for each of its
curves, and a number for each variable that says whether the knots lie on it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from drftjax.effects.base import AbstractEffect, strength
from drftjax.effects.catalogue import strengths
from drftjax.effects.correction import TURN, VARIABLES, Curve, curve_class, fields

Number = Float[Array, ""]


Held = Mapping[str, ArrayLike]


# Knots in a program's row at least: a curve's own sixteen, and one more to close it around a turn.
MIN_KNOT_COUNT = 17


@dataclass(frozen=True, eq=False)
class SharedProgram:
    """The class that an effect is compiled as.

    Attributes:
        effect: The class to compile.
        held: Its numbers that no fit changes, by field.
        mix: Its strengths as a linear map of the effect's own, shape (strengths, own strengths).
    """

    effect: type[AbstractEffect]
    held: Held
    mix: np.ndarray


@cache
def program_of(effect: type[AbstractEffect]) -> SharedProgram:
    """Program of an effect: its own class, but for a curve that of its stage."""
    if not issubclass(effect, Curve):
        return SharedProgram(effect, {}, np.eye(len(strengths(effect))))
    knots, values = _unrolled(effect)
    beyond = max(MIN_KNOT_COUNT - len(knots), 0)
    # Beyond its last knot a curve is level.
    knots = np.r_[knots, knots[-1] + np.arange(1.0, beyond + 1)]
    values = np.r_[values, np.repeat(values[-1:], beyond, axis=0)]
    picked = np.array([float(name == effect.variable) for name in VARIABLES])
    held = {"places": knots, "over": picked}
    return SharedProgram(_curve_of_stage(effect.stage, len(knots)), held, values)


def in_modes(
    kind: type[Curve], modes: Float[np.ndarray, "knots modes"], typical: float
) -> type[Curve]:
    """Class of a correction as a sum of curves, with their amplitudes as strengths.

    Args:
        kind: The correction's class.
        modes: The curves, one a column, by their values at its knots, in the correction's unit.
        typical: Typical size of the amplitudes [-].
    """
    names = [f"mode_{k}" for k in range(modes.shape[1])]

    def values(self: Curve) -> Float[Array, " knots"]:
        return jnp.asarray(modes) @ jnp.stack([getattr(self, name) for name in names])

    amplitudes = {name: strength("-", typical, "amplitude of a curve") for name in names}
    return curve_class(kind.stage, kind.variable, kind.knots, {**amplitudes, "values": values})


def _unrolled(kind: type[Curve]) -> tuple[np.ndarray, np.ndarray]:
    """A curve's knots, and its values there by each strength, shape (knots, strengths).

    One around a turn gets its last knot before its first, and its first behind its last.
    """
    names = strengths(kind)
    values = np.stack(
        [np.asarray(kind(**{n: float(n == one) for n in names}).values()) for one in names], axis=1
    )
    knots = np.asarray(kind.knots)
    if kind.variable != "wheel angle":
        return knots, values
    last, first = knots[-1] - TURN, knots[0] + TURN
    return np.r_[last, knots, first], np.r_[values[-1:], values, values[:1]]


@cache
def _curve_of_stage(stage: str, count: int) -> type[Curve]:
    """Class of a stage's curves with knots at `places`, on the variable that `over` picks."""

    def along(self, known: Mapping[str, Number]) -> Number:
        known = {**known}
        if "wheel angle" in known:
            known["wheel angle"] = jnp.mod(known["wheel angle"], TURN)
        variable = sum(
            pick * known[name]
            for pick, name in zip(self.over, VARIABLES, strict=True)
            if name in known
        )
        return jnp.interp(variable, self.places, self.values())

    held = {"places": eqx.field(), "over": eqx.field()}
    values = {name: strength("-", 1.0, "height of a curve at a knot") for name in fields(count)}
    nowhere = tuple(float(k) for k in range(count))
    return curve_class(stage, "any", nowhere, {**held, **values, "along": along})
