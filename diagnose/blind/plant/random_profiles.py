"""Curves drawn by lot along x, as tables that every run of every set can share a program with."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real

# What a wheel that goes forward comes by, and what one comes by that goes backward [m].
START, END, SPACING = -0.3, 6.0, 0.003


AHEAD = np.arange(START, END + SPACING / 2, SPACING)


BACK = round((START + END) / SPACING)


PLACES = np.concatenate([START - SPACING * np.arange(BACK, 0, -1), AHEAD])


class RandomCurve(eqx.Module):
    """A curve along x, linear between the points of a table, constant beyond.

    Attributes:
        values: Ordinates at `PLACES`.
    """

    values: Float[Array, " places"] = eqx.field(converter=as_real)

    def __call__(self, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
        place = jnp.clip((x - START) / SPACING, -BACK, len(AHEAD) - 1.001)
        before = jnp.floor(place).astype(jnp.int32)
        share = place - before.astype(place.dtype)
        row = before + BACK
        return self.values[row] * (1 - share) + self.values[row + 1] * share


def flat_curve() -> RandomCurve:
    return RandomCurve(np.zeros_like(PLACES))


def _edge(x: np.ndarray, width: float) -> np.ndarray:
    return 0.5 * (1 + np.tanh(x / width))


def draw_variation(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """How the sand's strength may vary along x: the kind of curve, and its values at `PLACES`."""
    kind = str(random.choice(["sinusoid", "smooth", "step patch", "ramp", "step"]))
    if kind == "sinusoid":
        values = np.sin(2 * np.pi * PLACES / random.uniform(0.25, 1.5) + random.uniform(0, 6.28))
    elif kind == "smooth":
        values = np.zeros_like(PLACES)
        for _ in range(6):
            wave = 2 * np.pi * PLACES / random.uniform(0.3, 2.5) + random.uniform(0, 6.28)
            values += random.normal() * np.sin(wave) / 2
    elif kind == "step patch":
        from_, long = random.uniform(0.15, 0.8), random.uniform(0.1, 0.5)
        values = _edge(PLACES - from_, 0.015) - _edge(PLACES - from_ - long, 0.015)
    elif kind == "step":
        values = _edge(PLACES - random.uniform(0.2, 0.8), random.uniform(0.01, 0.05))
    else:
        values = np.clip(PLACES, 0, 2)
    return kind, values - np.interp(0, PLACES, values)


def draw_profile(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """Heights that a surface may have along x, about one high: their kind, and the values."""
    kind = str(random.choice(["two waves", "bump", "rounded triangles"]))
    length = random.uniform(0.15, 0.9)
    wave = 2 * np.pi * PLACES / length + random.uniform(0, 6.28)
    if kind == "two waves":
        second = wave * random.uniform(1.4, 3.0) + random.uniform(0, 6.28)
        values = np.sin(wave) + random.uniform(0.2, 0.7) * np.sin(second)
    elif kind == "bump":
        away = (PLACES - random.uniform(0.2, 0.8)) / random.uniform(0.05, 0.25)
        values = 1 / (1 + away**4)
    else:
        values = np.arcsin(0.95 * np.sin(wave)) / 1.25
    return kind, values - np.interp(0, PLACES, values)
