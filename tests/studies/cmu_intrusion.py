"""Slow vertical intrusion: how far the force is from proportional to depth, and zeta by depth."""

import math
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from drftjax.physics.stress import NEWTON_PER_CUBIC_CENTIMETRE, StressCoefficients
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import vertical_support
from tests.studies.cmu_data import Intrusion, Reals
from tests.studies.cmu_steady import pitch_of

GRID = 2.5e-4
# Depth at which c of F = c (d / 10 mm)^n is quoted.
REFERENCE_DEPTH = 0.01


@dataclass(frozen=True)
class PowerLaw:
    """F = c ((d - d0) / 10 mm)^n.

    Attributes:
        c: Force at 10 mm [N].
        n: Exponent [-].
        n_error: Its standard error [-], with neighbouring residuals counted as one.
        touch: d0, the depth at which the surface is met [m].
        rms: Of the residuals [N].
    """

    c: float
    n: float
    n_error: float
    touch: float
    rms: float


class _Power(eqx.Module):
    log_c: Float[Array, ""]
    n: Float[Array, ""]
    touch: Float[Array, ""]

    def __call__(self, depth: Float[Array, " rows"]) -> Float[Array, " rows"]:
        # A small floor keeps the power's derivative finite where the surface is not yet met.
        below = jnp.maximum(depth - self.touch * 1e-3, 1e-6) / REFERENCE_DEPTH
        return jnp.exp(self.log_c + self.n * jnp.log(below))


def power_law(
    run: Intrusion, low: float = 0.0, high: float = math.inf, *, find_touch: bool = False
) -> PowerLaw:
    """Least squares in newtons over depths from `low` to `high` [m].

    Args:
        run: The intrusion.
        low, high: Range of depth [m].
        find_touch: Whether d0 is fitted too; 0 where it is not.
    """
    depth, force = run.on_grid(GRID)
    within = (depth >= low) & (depth <= high)
    depth, force = jnp.asarray(depth[within]), jnp.asarray(force[within])
    law, jacobian, residual = _fit_power(depth, force, jnp.asarray(1.0 if find_touch else 0.0))
    left = np.asarray(residual)
    columns = np.asarray(jacobian)[:, : 3 if find_touch else 2]
    variance = left @ left / (left.size - columns.shape[1])
    correlation = float(np.clip(left[1:] @ left[:-1] / (left @ left), 0, 0.999))
    inflated = variance * (1 + correlation) / (1 - correlation)
    covariance = inflated * np.linalg.inv(columns.T @ columns)
    return PowerLaw(
        c=float(jnp.exp(law.log_c)),
        n=float(law.n),
        n_error=float(np.sqrt(covariance[1, 1])),
        touch=float(law.touch) * 1e-3,
        rms=float(np.sqrt(np.mean(left**2))),
    )


@jax.jit
def _fit_power(
    depth: Float[Array, " rows"], force: Float[Array, " rows"], find_touch: Float[Array, ""]
):
    def misfit(values: Float[Array, "3"], _) -> Float[Array, " rows"]:
        return _Power(values[0], values[1], find_touch * values[2])(depth) - force

    start = jnp.stack([jnp.log(jnp.max(force)) - 1, jnp.ones(()), jnp.zeros(())])
    solver = optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    found = optx.least_squares(misfit, solver, start, max_steps=400, throw=False)
    law = _Power(found.value[0], found.value[1], find_touch * found.value[2])
    return law, jax.jacfwd(misfit)(found.value, None), misfit(found.value, None)


def plate_slope(diameter: float) -> float:
    """Force per depth on a flat plate that goes straight down, at zeta = 1 [N/m]."""
    down = (jnp.asarray(0.0), jnp.asarray(-1.0))
    alpha_z = StressCoefficients.generic()(*down, *down)[1]
    return float(alpha_z) * NEWTON_PER_CUBIC_CENTIMETRE * math.pi * diameter**2 / 4


def proportional_zeta(
    run: Intrusion, low: float = 0.0, high: float = math.inf, *, samples: bool = False
) -> float:
    """zeta of F = zeta slope d by least squares in newtons [-].

    Args:
        run: Intrusion of a plate.
        low, high: Range of depth [m].
        samples: Whether every sample counts, as they come in time, and not every depth.
    """
    depth, force = (run.depth, run.force) if samples else run.on_grid(GRID)
    within = (depth >= low) & (depth <= high)
    depth, force = depth[within], force[within]
    return float(depth @ force / (depth @ depth)) / plate_slope(run.diameter)


@dataclass(frozen=True)
class WheelIntrusion:
    """What a wheel's intrusion says of zeta.

    Attributes:
        zeta: One zeta for all depths, the zero as in the file [-].
        rms: Its residual [N].
        free_zeta, touch, free_rms: The same with the depth of the surface fitted too.
        depths, zetas: zeta that each depth needs; shape (depths,).
    """

    zeta: float
    rms: float
    free_zeta: float
    touch: float
    free_rms: float
    depths: Reals
    zetas: Reals


DEPTHS = np.array([5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]) * 1e-3


def wheel_intrusion(run: Intrusion, simulator: Simulator, below_rim: float) -> WheelIntrusion:
    """Fit zeta to a wheel's intrusion through the statics.

    Args:
        run: Intrusion of a wheel.
        simulator: The wheel on the sand.
        below_rim: Depth of the rim's lowest point over the file's zero [m].
    """
    support = _support(simulator, below_rim)
    depth, force = run.on_grid(1e-3)
    depth, force = jnp.asarray(depth), jnp.asarray(force)

    def misfit(values: Float[Array, "2"], find_touch: Float[Array, ""]) -> Float[Array, " rows"]:
        return values[0] * support(depth - find_touch * values[1] * 1e-3) - force

    solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8)

    @jax.jit
    def fit(find_touch):
        start = jnp.asarray([1.0, 0.0])
        found = optx.least_squares(misfit, solver, start, find_touch, max_steps=200, throw=False)
        return found.value, jnp.sqrt(jnp.mean(misfit(found.value, find_touch) ** 2))

    (zeta, _), rms = fit(jnp.asarray(0.0))
    (free, touch), free_rms = fit(jnp.asarray(1.0))
    depths = DEPTHS[run.depth.max() >= DEPTHS]
    at = np.interp(depths, np.asarray(depth), np.asarray(force))
    zetas = at / np.asarray(jax.jit(support)(jnp.asarray(depths)))
    return WheelIntrusion(
        float(zeta), float(rms), float(free), float(touch) * 1e-3, float(free_rms), depths, zetas
    )


def _support(simulator: Simulator, below_rim: float):
    """Vertical force at zeta = 1 by depth from the file's zero, averaged over the wheel's angle."""
    simulator = simulator.prepared()
    pitch = pitch_of(simulator.wheel)
    angles = jnp.arange(16 if pitch else 1) / 16 * (pitch or 1.0)

    def at(depth: Float[Array, ""]) -> Float[Array, ""]:
        turned = jax.vmap(lambda a: vertical_support(simulator, depth - below_rim, 1.0, a))
        return turned(angles).mean()

    return jax.vmap(at)
