"""The runs that tests and studies share: the paper's profile, and the reference trajectories."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.physics.command import Command, command_at
from drftjax.physics.rig import Rig
from drftjax.physics.state import Output, State
from drftjax.physics.stress import Dynamic, QuasiStatic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.runlog.hdf5.api import read_run
from drftjax.simulation.rollout import simulate, step_times
from drftjax.simulation.simulator import Simulator

REFERENCE_RUNS = (
    "paper",
    "paper_quasistatic",
    "plain_wheel",
    "damped",
    "soft_30deg",
    "light_30deg",
    "fast_90deg",
    "fast_300deg",
)

# Profile of Table 2 of Fuke et al. 2024: knots in time [s] and omega [deg/s].
PAPER_TIME = (0.0, 2.0, 7.0, 17.0, 22.0, 24.0)
PAPER_OMEGA = (0.0, 0.0, 30.0, 30.0, 0.0, 0.0)
PAPER_SINKAGE = 0.0176

roll = eqx.filter_jit(simulate)


class Run(eqx.Module):
    """A simulator, the sinkage it starts from at rest, and its command over time."""

    simulator: Simulator
    sinkage: float
    time: Float[Array, " knots"]
    omega: Float[Array, " knots"]

    def commands(self, step: float) -> Command:
        steps = round(float(self.time[-1]) / step)
        return command_at(step_times(steps, step), self.time, self.omega)

    def start(self) -> State:
        return State.at_rest(self.sinkage)

    def rows(self, step: float, interval: float = 0.01) -> Output:
        """The run with this step [s], a row each `interval` [s]."""
        every = round(interval / step)
        return roll(self.simulator, self.start(), self.commands(step), step, every=every)[1]


def profile(
    simulator: Simulator | None = None,
    time=PAPER_TIME,
    degrees_per_second=PAPER_OMEGA,
    sinkage: float = PAPER_SINKAGE,
) -> Run:
    """A run of a profile given at its knots; the paper's where nothing is said."""
    simulator = Simulator() if simulator is None else simulator
    omega = np.radians(np.asarray(degrees_per_second, float))
    return Run(simulator, sinkage, jnp.asarray(time, float), jnp.asarray(omega))


def reference(
    folder: Path, name: str, plate_size: float = 0.004
) -> tuple[Run, np.ndarray, np.ndarray]:
    """A reference run as this project would make it, and the z and x [m] it is to meet.

    The rows of `Run.rows` are the reference's without its first.
    """
    log = read_run(folder / "reference_rigs" / f"{name}.h5")
    radius, width, mass_x, mass_z, zeta, sinkage = log.setup.require(
        "wheel_radius",
        "wheel_width",
        "mass_x",
        "mass_z",
        "scaling_factor_initial",
        "sinkage_static",
    )
    wheel = PlainWheel if log.setup.grouser_count == 0 else GrouserWheel
    law = QuasiStatic() if name == "paper_quasistatic" else Dynamic()
    damping_x, damping_z = (30.0, 300.0) if name == "damped" else (0.0, 0.0)
    simulator = Simulator(
        wheel(radius, width, plate_size=plate_size),
        Terrain(ConstantZeta(zeta), law),
        Rig(mass_x, mass_z, damping_x, damping_z),
    )
    time, omega = jnp.asarray(log.command.time), jnp.asarray(log.command.omega)
    z, x = log.measured.z, log.measured.x
    assert z is not None, name
    assert x is not None, name
    return Run(simulator, sinkage, time, omega), z[1:], x[1:]
