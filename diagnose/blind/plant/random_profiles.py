"""Random curves along x, as tables of one size, so that all runs of all sets share a program."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real

# Ends and spacing of the table for a wheel that goes forward [m].
FORWARD_START, FORWARD_END, SPACING = -0.3, 6.0, 0.003
FORWARD_PLACES = np.arange(FORWARD_START, FORWARD_END + SPACING / 2, SPACING)
# Points added behind it, so that a wheel that goes backward finds as much.
BACKWARD_POINTS = round((FORWARD_START + FORWARD_END) / SPACING)
PLACES = np.concatenate(
    [FORWARD_START - SPACING * np.arange(BACKWARD_POINTS, 0, -1), FORWARD_PLACES]
)


class RandomCurve(eqx.Module):
    """Curve along x, linear between the points of a table, constant beyond.

    Attributes:
        values: Ordinates at `PLACES`, shape (places,).
    """

    values: Float[Array, " places"] = eqx.field(converter=as_real)

    def __call__(self, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
        point = (x - FORWARD_START) / SPACING
        point = jnp.clip(point, -BACKWARD_POINTS, len(FORWARD_PLACES) - 1.001)
        before = jnp.floor(point).astype(jnp.int32)
        share = point - before.astype(point.dtype)
        row = before + BACKWARD_POINTS
        return self.values[row] * (1 - share) + self.values[row + 1] * share


def flat_curve() -> RandomCurve:
    """Curve that is zero everywhere."""
    return RandomCurve(np.zeros_like(PLACES))


def _smooth_step(x: np.ndarray, width: float) -> np.ndarray:
    return 0.5 * (1 + np.tanh(x / width))


def draw_variation(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """Draw a variation of the strength of the sand along x.

    Returns:
        The kind of curve, and its values at `PLACES`, zero at the start, of order one [-].
    """
    kind = str(random.choice(["sinusoid", "smooth", "step patch", "ramp", "step"]))
    if kind == "sinusoid":
        values = np.sin(2 * np.pi * PLACES / random.uniform(0.25, 1.5) + random.uniform(0, 6.28))
    elif kind == "smooth":
        values = np.zeros_like(PLACES)
        for _ in range(6):
            wave = 2 * np.pi * PLACES / random.uniform(0.3, 2.5) + random.uniform(0, 6.28)
            values += random.normal() * np.sin(wave) / 2
    elif kind == "step patch":
        start, length = random.uniform(0.15, 0.8), random.uniform(0.1, 0.5)
        values = _smooth_step(PLACES - start, 0.015) - _smooth_step(PLACES - start - length, 0.015)
    elif kind == "step":
        values = _smooth_step(PLACES - random.uniform(0.2, 0.8), random.uniform(0.01, 0.05))
    else:
        values = np.clip(PLACES, 0, 2)
    return kind, values - np.interp(0, PLACES, values)


def draw_profile(random: np.random.Generator) -> tuple[str, np.ndarray]:
    """Draw a profile of the surface along x.

    Returns:
        The kind of curve, and its values at `PLACES`, zero at the start, of order one [-].
    """
    kind = str(random.choice(["two waves", "bump", "rounded triangles"]))
    length = random.uniform(0.15, 0.9)
    wave = 2 * np.pi * PLACES / length + random.uniform(0, 6.28)
    if kind == "two waves":
        second = wave * random.uniform(1.4, 3.0) + random.uniform(0, 6.28)
        values = np.sin(wave) + random.uniform(0.2, 0.7) * np.sin(second)
    elif kind == "bump":
        distance = (PLACES - random.uniform(0.2, 0.8)) / random.uniform(0.05, 0.25)
        values = 1 / (1 + distance**4)
    else:
        values = np.arcsin(0.95 * np.sin(wave)) / 1.25
    return kind, values - np.interp(0, PLACES, values)
