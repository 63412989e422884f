"""Short simulated runs, for tests of fits."""

import dataclasses
from pathlib import Path

import numpy as np

from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.runlog.record import Measured, RecordedSetup, RunLog
from drftjax.setups.setup import CommandSetUp, RigSetUp, SetUp
from drftjax.setups.setup_toml import setup_toml
from drftjax.setups.simulated_run import simulated_run
from drftjax.simulation.statics import sinkage_under_load

# Knots in time [s] and omega [rad/s]: the paper's wheel speed, and eight times as much.
SLOW = ([0.0, 0.25, 1.0, 1.5], [0.0, 0.0, 0.5, 0.5])
FAST = ([0.0, 0.25, 1.25, 2.25], [0.0, 0.0, 4.0, 4.0])
# Steps at which derivatives are slopes over a fit's errors [s].
SLOW_STEP, FAST_STEP = 4e-3, 1e-3
# Sinkage of a wheel that stands over what its load asks for at the least [-].
DEEPER = 1.1

# Coarse plates, so that tests are quick; longer ones make the derivatives rough.
PLATE = 0.005
NOISE = 20e-6
BELIEVED_ZETA = 0.7823


def write_believed_setup(path: Path) -> Path:
    """Write the slow run's set-up as it is believed, with coarse plates as all fits here have."""
    setup = setup_of(SLOW)
    setup.terrain.zeta = BELIEVED_ZETA
    path.write_text(setup_toml(setup))
    return path


def step_for(omega) -> float:
    """Time step for simulating and fitting a run with these speeds [s]."""
    return FAST_STEP if max(omega) > 1 else SLOW_STEP


def setup_of(profile=SLOW, zeta: float = 0.75, vx: list[float] | None = None) -> SetUp:
    """True set-up of a run, with the integrator of fits."""
    time, omega = profile
    rig = RigSetUp(carriage="free" if vx is None else "driven")
    command = CommandSetUp(list(time), list(omega), vx)
    setup = SetUp(command=command, title="a virtual run", rig=rig)
    setup.wheel.plate_size = PLATE
    setup.terrain.zeta = zeta
    setup.integrator.step = step_for(omega)
    # The wheel was let down and stands, a little deeper than it needs to: at the very least depth a
    # pull to either side lets it sink on, and so does a zeta that is a trace too small.
    setup.start.sinkage = DEEPER * float(sinkage_under_load(setup.trial().simulator, zeta))
    return setup


def recorded(
    setup: SetUp,
    seed: int = 0,
    rate: float = 50.0,
    noise: float = NOISE,
    channels: tuple[str, ...] = ("x", "z"),
    force_noise: float = 0.0,
) -> RunLog:
    """Run log of a set-up as a rig records it, with noise and without its zeta."""
    log = simulated_run(setup, 1 / rate)
    random = np.random.default_rng(seed)
    measured = {}
    for name in channels:
        values = getattr(log.measured, name)
        scale = noise if name in ("x", "z") else force_noise
        measured[name] = values + scale * random.standard_normal(len(values))
    believed = RecordedSetup(**log.setup.known() | {"scaling_factor_initial": BELIEVED_ZETA})
    return dataclasses.replace(
        log, setup=believed, measured=Measured(time=log.measured.time, **measured)
    )


def coarse(name: str, run: RunLog, **options) -> PreparedRun:
    """Prepare a run with the plates and the step of its simulation, which no run log holds."""
    options.setdefault("step", step_for(run.command.omega))
    return recut(prepare_run(name, run, **options))


def recut(each: PreparedRun, plate_size: float = PLATE) -> PreparedRun:
    each.setup.wheel.plate_size = plate_size
    trial = each.setup.trial(interval=0)
    return dataclasses.replace(each, trial=trial)
