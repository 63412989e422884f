"""Eq. 7 and a rig in one compiled loop: many settings of the tuner side by side.

The rig is a second simulation whose carriage is driven at the first one's speed. There is no wire,
no clock and no guard here, so that what is seen comes from eq. 7 and the sand; the whole loop with
all of these is `hils.experiment.experiment`.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from drftjax.effects.terrain import Loosening
from drftjax.physics.command import Command
from drftjax.physics.rig import DrivenCarriage
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import sinkage_under_load, zeta_from_sinkage
from drftjax.tuning.step_tuner import with_zeta_per_step

STEP = 1e-3
STEPS_A_ROW = 10
RAMP = 2.0
# Longer ones change the tuner's ripple: a table of the study.
PLATE = 1e-3
ZETA, LOSS = 0.7823, 0.2
SPEED = float(np.radians(30.0))


class Setting(NamedTuple):
    """One loop.

    Attributes:
        tick: Control period [s], in whole milliseconds.
        zeta_step, tolerance: Of eq. 7 [-], [m].
        damping_x, damping_z: Of the simulated rig alone [N s/m].
        angle: By how much the real wheel's grousers are ahead of the simulated ones [rad].
        dropped: By how much less deep than at rest both wheels are let go [m].
        omega: Angular velocity in the end [rad/s].
        noise: Standard deviation of a reading [m].
    """

    tick: float = 0.01
    zeta_step: float = 1e-3
    tolerance: float = 1e-4
    damping_x: float = 0.0
    damping_z: float = 0.0
    angle: float = 0.0
    omega: float = SPEED
    noise: float = 2e-5
    dropped: float = 0.0


class Traces(NamedTuple):
    """What came of each setting, every 10 ms: shape (settings, rows).

    Attributes:
        z_sim, z_real: Height of the axle [m].
        zeta: As tuned [-].
    """

    z_sim: np.ndarray
    z_real: np.ndarray
    zeta: np.ndarray

    def steady(self, since: float) -> "Traces":
        """What came after so long [s]."""
        first = round(since / (STEP * STEPS_A_ROW))
        return Traces(*(values[:, first:] for values in self))


INTERVAL = STEP * STEPS_A_ROW


def wheel(grousers: bool, plate: float) -> GrouserWheel | PlainWheel:
    """The paper's wheel, with its grousers or without, of plates this long [m]."""
    return GrouserWheel(plate_size=plate) if grousers else PlainWheel(plate_size=plate)


def run(
    settings: Sequence[Setting],
    duration: float,
    grousers: bool = True,
    simulated_grousers: bool | None = None,
    plate: float = PLATE,
    seeds: Sequence[int] | None = None,
) -> Traces:
    """Every setting from rest up to its speed, and on.

    Args:
        settings: What to try.
        duration: Of each [s].
        grousers: Whether the real wheel has its grousers.
        simulated_grousers: Whether the simulated one has; as the real one where not said.
        plate: Length of the plates of either wheel [m].
        seeds: Of each setting's noise; 0, 1, 2, ... where not said.
    """
    simulated = grousers if simulated_grousers is None else simulated_grousers
    terrain = Terrain(ConstantZeta(ZETA))
    loop = with_zeta_per_step(Simulator(wheel(simulated, plate), terrain))
    rig = Simulator(wheel(grousers, plate), terrain, effects=(Loosening(LOSS, 2.0),))
    # At rest the real wheel is as deep as its angle has it, and zeta(0) is what that tells.
    angles = {setting.angle for setting in settings}
    rest = {angle: float(sinkage_under_load(rig, ZETA, angle=angle)) for angle in angles}
    told = {angle: float(zeta_from_sinkage(loop, depth)) for angle, depth in rest.items()}
    depths = np.array([rest[setting.angle] - setting.dropped for setting in settings])
    zetas = np.array([told[setting.angle] for setting in settings])
    rig = dataclasses.replace(rig, rig=dataclasses.replace(rig.rig, carriage=DrivenCarriage()))
    rig = rig.prepared()
    rows = round(duration / INTERVAL)
    columns = [np.asarray(column, float) for column in zip(*settings, strict=True)]
    every = np.maximum(1, np.round(columns[0] / STEP)).astype(int)

    def one(
        setting: Setting,
        every: Int[Array, ""],
        sinkage: Float[Array, ""],
        start: Float[Array, ""],
        key: Array,
    ) -> tuple[Array, Array, Array]:
        damped = dataclasses.replace(
            loop.rig, damping_x=setting.damping_x, damping_z=setting.damping_z
        )
        simulator = dataclasses.replace(loop, rig=damped)
        nought = jnp.zeros_like(setting.tick)
        still = Command(nought, nought, nought)
        state = State.at_rest(sinkage)
        real = rig.begin(State.at_rest(sinkage, 0.0, setting.angle), still)

        def step(carried, reading_noise: Float[Array, ""]):
            number, state, real, zeta = carried
            error = (reading_noise - real.position[1]) + state.position[1]
            up, down = error < -setting.tolerance, error > setting.tolerance
            change = jnp.where(up, setting.zeta_step, jnp.where(down, -setting.zeta_step, 0.0))
            zeta = zeta + jnp.where(number % every == 0, change, 0.0)
            time = STEP * (number + 1).astype(float)
            omega = setting.omega * jnp.clip(time / RAMP, 0.0, 1.0)
            state, _ = simulator.step(state, Command(omega, nought, zeta), STEP)
            real, _ = rig.step(real, Command(omega, state.velocity[0], nought), STEP)
            return (number + 1, state, real, zeta), None

        def row(carried, noises: Float[Array, " steps"]):
            carried, _ = jax.lax.scan(step, carried, noises)
            _, state, real, zeta = carried
            return carried, (state.position[1], real.position[1], zeta)

        noises = setting.noise * jax.random.normal(key, (rows, STEPS_A_ROW))
        begun = (jnp.zeros((), int), state, real, start)
        return jax.lax.scan(row, begun, noises)[1]

    keys = jax.vmap(jax.random.key)(np.arange(len(settings)) if seeds is None else np.array(seeds))
    columns = Setting(*map(jnp.asarray, columns))
    made = jax.jit(jax.vmap(one))(columns, *map(jnp.asarray, (every, depths, zetas)), keys)
    return Traces(*map(np.asarray, made))
