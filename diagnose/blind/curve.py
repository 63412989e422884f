"""Curves drawn by lot along x, as tables that every run of every set can share a program with."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.arrays import as_real

# Everything that a run can reach, and the wheel's reach before and behind it [m]: what a wheel that
# goes forward comes by, and what one comes by that goes backward.
START, END, SPACING = -0.3, 6.0, 0.003
AHEAD = np.arange(START, END + SPACING / 2, SPACING)
BACK = round((START + END) / SPACING)
BEHIND = START - SPACING * np.arange(BACK, 0, -1)

Values = Callable[[np.ndarray], np.ndarray]


class Curve(eqx.Module):
    """A curve along x, linear between the points of a table, constant beyond.

    Attributes:
        values: Ordinates at `BEHIND` and `AHEAD`.
    """

    values: Float[Array, " places"] = eqx.field(converter=as_real)

    def __call__(self, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
        place = jnp.clip((x - START) / SPACING, -BACK, len(AHEAD) - 1.001)
        before = jnp.floor(place).astype(jnp.int32)
        share = place - before.astype(place.dtype)
        row = before + BACK
        return self.values[row] * (1 - share) + self.values[row + 1] * share


def flat() -> Curve:
    return Curve(np.zeros(BACK + len(AHEAD)))


def _from_the_start(values: Values) -> np.ndarray:
    """A curve at `BEHIND` and `AHEAD`, zero where every run starts."""
    ahead = values(AHEAD)
    return np.concatenate([values(BEHIND), ahead]) - np.interp(0, AHEAD, ahead)


def _edge(x: np.ndarray, width: float) -> np.ndarray:
    return 0.5 * (1 + np.tanh(x / width))


def drawn_variation(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """How the sand's strength may vary along x: the kind of curve, and its values."""
    kind = str(random.choice(["sinusoid", "smooth", "step patch", "ramp", "step"]))
    if kind == "sinusoid":
        length, phase = random.uniform(0.25, 1.5), random.uniform(0, 6.28)

        def values(x: np.ndarray) -> np.ndarray:
            return np.sin(2 * np.pi * x / length + phase)

    elif kind == "smooth":
        waves = [
            (random.uniform(0.3, 2.5), random.uniform(0, 6.28), random.normal()) for _ in range(6)
        ]

        def values(x: np.ndarray) -> np.ndarray:
            total = np.zeros_like(x)
            for length, phase, size in waves:
                total += size * np.sin(2 * np.pi * x / length + phase) / 2
            return total

    elif kind == "step patch":
        from_, long = random.uniform(0.15, 0.8), random.uniform(0.1, 0.5)

        def values(x: np.ndarray) -> np.ndarray:
            return _edge(x - from_, 0.015) - _edge(x - from_ - long, 0.015)

    elif kind == "step":
        from_, width = random.uniform(0.2, 0.8), random.uniform(0.01, 0.05)

        def values(x: np.ndarray) -> np.ndarray:
            return _edge(x - from_, width)

    else:

        def values(x: np.ndarray) -> np.ndarray:
            return np.clip(x, 0, 2)

    return kind, _from_the_start(values)


def drawn_profile(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """Heights that a surface may have along x, about one high: their kind, and the values."""
    kind = str(random.choice(["two waves", "bump", "rounded triangles"]))
    length, phase = random.uniform(0.15, 0.9), random.uniform(0, 6.28)

    def wave(x: np.ndarray) -> np.ndarray:
        return 2 * np.pi * x / length + phase

    if kind == "two waves":
        closer, later = random.uniform(1.4, 3.0), random.uniform(0, 6.28)
        size = random.uniform(0.2, 0.7)

        def values(x: np.ndarray) -> np.ndarray:
            return np.sin(wave(x)) + size * np.sin(wave(x) * closer + later)

    elif kind == "bump":
        centre, width = random.uniform(0.2, 0.8), random.uniform(0.05, 0.25)

        def values(x: np.ndarray) -> np.ndarray:
            return 1 / (1 + ((x - centre) / width) ** 4)

    else:

        def values(x: np.ndarray) -> np.ndarray:
            return np.arcsin(0.95 * np.sin(wave(x))) / 1.25

    return kind, _from_the_start(values)
