"""Steady driving, two ways: at the height that carries the load, and simulated until steady.

The steady means come from the first: the rig's vertical axis does not follow the grousers, and
the answer needs no time to settle. The second is its check, and tells the ripple of a free axis.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.physics.command import Command
from drftjax.physics.integrator import DEFAULT_STEP
from drftjax.physics.rig import DrivenCarriage, Rig
from drftjax.physics.state import State
from drftjax.physics.stress import Dynamic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import AbstractWheel
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator

DURATION = 20.0
# Wheel angles over a pitch at which a held wheel's force is taken.
ANGLES = 32
# Of the range of sinkages: to a thousandth of a micrometre.
HALVINGS = 26
LEAST_ZETA, MOST_ZETA, NARROWINGS = 0.1, 4.0, 28
# Averages are taken over the whole grouser pitches that fit into this, or over one pitch.
WINDOW = 6.0
LAMBDA, BULK_DENSITY, GRAVITY = 1.1, 1330.0, 9.81


class Setting(eqx.Module):
    """What the rig was set to; one number each, or with a leading axis of rows.

    Attributes:
        vx: Carriage speed [m/s].
        omega: Wheel speed [rad/s].
        load: Vertical load on the wheel [N].
    """

    vx: Float[Array, "*rows"]
    omega: Float[Array, "*rows"]
    load: Float[Array, "*rows"]


class Steady(eqx.Module):
    """Means over whole grouser pitches at the end of a run.

    Attributes:
        sinkage: H from the rim [m].
        forward, up: Force of the sand on the wheel [N].
        ripple: Standard deviation of the sinkage over the pitches [m].
        drift: Change of the mean sinkage since one window earlier [m].
    """

    sinkage: Float[Array, "*rows"]
    forward: Float[Array, "*rows"]
    up: Float[Array, "*rows"]
    ripple: Float[Array, "*rows"]
    drift: Float[Array, "*rows"]


def driven(wheel: AbstractWheel, law: Dynamic | None = None) -> Simulator:
    """The wheel on dry sand of 1330 kg/m3 under a driven carriage, without zeta and load yet."""
    law = Dynamic(LAMBDA, BULK_DENSITY) if law is None else law
    rig = Rig(carriage=DrivenCarriage(), gravity=GRAVITY)
    return Simulator(wheel, Terrain(ConstantZeta(1.0), law), rig)


def steady_state(
    simulator: Simulator,
    zeta: Float[Array, ""],
    setting: Setting,
    start: Float[Array, ""],
    *,
    step: float = DEFAULT_STEP,
    duration: float = DURATION,
) -> Steady:
    """Simulate at constant speeds until steady, and average over whole grouser pitches.

    Args:
        simulator: Wheel and sand; its zeta and mass_z are replaced.
        zeta: Scaling factor [-].
        setting: Speeds and load of one row; `jax.vmap` makes many.
        start: Sinkage to start from [m]; the steady state does not depend on it.
        step, duration: Of the simulation [s].
    """
    rig = dataclasses.replace(simulator.rig, mass_z=setting.load / simulator.rig.gravity)
    simulator = dataclasses.replace(
        simulator.prepared(),
        terrain=Terrain(ConstantZeta(zeta), simulator.terrain.law),
        rig=rig,
    )
    nought = jnp.zeros_like(start)
    state = State(
        nought,
        jnp.stack([nought, -start]),
        jnp.stack([setting.vx, nought]),
        nought,
        setting.omega,
    )
    steps = round(duration / step)
    held = jnp.ones(steps, start.dtype)
    commands = Command(setting.omega * held, setting.vx * held, zeta * held)
    _, rows = simulate(simulator, state, commands, step)

    span = _window(simulator.wheel, setting.omega)

    def mean(values: Float[Array, " steps"], end: Float[Array, ""]) -> Float[Array, ""]:
        share = jnp.clip((rows.time - end + span) / step, 0, 1)
        share = share * jnp.clip((end - rows.time) / step + 1, 0, 1)
        return jnp.sum(share * values) / jnp.sum(share)

    last = jnp.asarray(duration, start.dtype)
    sinkage = mean(rows.sinkage, last)
    square = mean((rows.sinkage - sinkage) ** 2, last)
    # Not differentiable where there is no ripple; nothing is fitted to it.
    ripple = jnp.sqrt(jax.lax.stop_gradient(square))
    drift = sinkage - mean(rows.sinkage, last - span)
    return Steady(sinkage, mean(rows.fx, last), mean(rows.fz, last), ripple, drift)


def pitch_of(wheel: AbstractWheel) -> float:
    """The angle at which a wheel that is cut repeats itself [rad]; 0 where it does not turn."""
    return float(getattr(wheel.cut(), "pitch", 0.0))


def _window(wheel: AbstractWheel, omega: Float[Array, ""]) -> Float[Array, ""]:
    pitch = pitch_of(wheel)
    turning = (omega != 0) & (pitch > 0)
    period = pitch / jnp.where(turning, jnp.abs(omega), 1.0)
    whole = jnp.maximum(1.0, jnp.floor(WINDOW / jnp.where(turning, period, 1.0)))
    return jnp.where(turning, whole * period, WINDOW)


@eqx.filter_jit
def steady_states(
    simulator: Simulator,
    zeta: Float[Array, " rows"],
    setting: Setting,
    start: Float[Array, " rows"],
    *,
    step: float = DEFAULT_STEP,
    duration: float = DURATION,
) -> Steady:
    """`steady_state` of many rows at once."""

    def one(zeta, setting, start) -> Steady:
        return steady_state(simulator, zeta, setting, start, step=step, duration=duration)

    return jax.vmap(one)(zeta, setting, start)


class HeldForce(eqx.Module):
    """Mean force of the sand on a wheel at a held height, `constant` + zeta `slope`.

    Attributes:
        constant, slope: Forward and up [N] and the drive torque [N m], shape (rows, 3).
        ripple: Standard deviation of the upward slope over a pitch [N], shape (rows,).
    """

    constant: Float[Array, "rows 3"]
    slope: Float[Array, "rows 3"]
    ripple: Float[Array, " rows"]

    def zeta(self, load: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """The zeta [-] at which the sand carries `load` [N]."""
        return (load - self.constant[:, 1]) / self.slope[:, 1]

    def forward(self, zeta: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Forward force [N] at this zeta."""
        return self.constant[:, 0] + zeta * self.slope[:, 0]

    def torque(self, zeta: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Drive torque against the sand [N m] at this zeta."""
        return self.constant[:, 2] + zeta * self.slope[:, 2]


def _force_by_angle(
    simulator: Simulator, setting: Setting, sinkage: Float[Array, ""], zeta: Float[Array, ""]
) -> Float[Array, "angles 3"]:
    """Forward and upward force [N] and drive torque [N m] over a pitch, at a held height."""
    pitch = pitch_of(simulator.wheel)
    angles = jnp.arange(ANGLES if pitch else 1) / ANGLES * (pitch or 1.0)
    place = jnp.stack([jnp.zeros_like(sinkage), -sinkage])
    speed = jnp.stack([setting.vx, jnp.zeros_like(setting.vx)])
    turned = jax.vmap(lambda angle: simulator.wrench(place, speed, angle, setting.omega, zeta))
    return turned(angles)


@eqx.filter_jit
def held_force(simulator: Simulator, setting: Setting, sinkage: Float[Array, " rows"]) -> HeldForce:
    """Force on a wheel that drives at a held height, averaged over a pitch.

    Args:
        simulator: Wheel and sand.
        setting: Speeds of every row.
        sinkage: From the rim [m].
    """
    simulator = simulator.prepared()
    force = jax.vmap(lambda *row: _force_by_angle(simulator, *row))
    constant = force(setting, sinkage, jnp.zeros_like(sinkage))
    slope = force(setting, sinkage, jnp.ones_like(sinkage)) - constant
    return HeldForce(constant.mean(1), slope.mean(1), slope[:, :, 1].std(1))


@eqx.filter_jit
def held_sinkage(
    simulator: Simulator, setting: Setting, zeta: Float[Array, ""]
) -> Float[Array, " rows"]:
    """Height at which the sand carries each row's load on the mean over a pitch [m].

    It is the steady state of a wheel without ripple, and of one whose axis does not follow the
    ripple, as the rig's does not.
    """
    simulator = simulator.prepared()
    limit = simulator.wheel.cut().sinkage_limit

    def one(setting: Setting) -> Float[Array, ""]:
        def missing(sinkage: Float[Array, ""]) -> Float[Array, ""]:
            return _force_by_angle(simulator, setting, sinkage, zeta)[:, 1].mean() - setting.load

        def halve(_, bracket):
            low, high = bracket
            middle = (low + high) / 2
            short = missing(middle) < 0
            return jnp.where(short, middle, low), jnp.where(short, high, middle)

        low, _ = jax.lax.fori_loop(0, HALVINGS, halve, (-limit / 4, limit))
        return low

    return jax.vmap(one)(setting)


@eqx.filter_jit
def fit_zeta(
    simulator: Simulator,
    setting: Setting,
    sinkage: Float[Array, " rows"],
    chosen: Float[Array, " rows"],
) -> Float[Array, ""]:
    """The one zeta [-] whose steady sinkages come closest to those measured, in least squares.

    Args:
        simulator: Wheel and sand.
        setting: Speeds and load of every row.
        sinkage: Measured, from the rim [m].
        chosen: 1 for the rows that count, 0 for the others.
    """

    def misfit(zeta: Float[Array, ""]) -> Float[Array, ""]:
        found = held_sinkage(simulator, setting, zeta)
        return jnp.sum(chosen * (found - sinkage) ** 2)

    # One number, and a misfit that kinks wherever a plate meets the surface: thirds, no derivative.
    def narrow(_, bracket):
        low, high = bracket
        third = (high - low) / 3
        right = misfit(low + third) > misfit(high - third)
        return jnp.where(right, low + third, low), jnp.where(right, high, high - third)

    ends = (jnp.asarray(LEAST_ZETA, sinkage.dtype), jnp.asarray(MOST_ZETA, sinkage.dtype))
    low, high = jax.lax.fori_loop(0, NARROWINGS, narrow, ends)
    return (low + high) / 2
