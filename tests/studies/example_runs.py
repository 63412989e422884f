"""The runs in data/runs: a rig of our own, with what an experimenter does not know.

Run as `python -m tests.studies.example_runs`. The physics are integrated in finer steps than a fit
takes. zeta scatters by 1 % from run to run, as a bed prepared anew does; the scales read to a
micrometre with 20 um of noise.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drftjax.common.jax_config import configure_jax
from drftjax.effects.serialization import Entry
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RunLog

FOLDER = Path(__file__).parents[2] / "data" / "runs"
SEED = 20240718
ZETA, SCATTER = 0.74, 0.01
NOISE, COUNT = 20e-6, 1e-6
RATE = 50.0
STEP = 1.25e-4

# Name: (knots in time [s], angular velocity [deg/s]).
PROFILES = {
    "slow_a": ([0, 2, 7, 17, 22, 24], [0, 0, 30, 30, 0, 0]),
    "slow_b": ([0, 2, 7, 17, 22, 24], [0, 0, 30, 30, 0, 0]),
    "medium": ([0, 1, 4, 9, 12, 13], [0, 0, 90, 90, 0, 0]),
    "fast": ([0, 1, 3, 6, 8, 9], [0, 0, 240, 240, 0, 0]),
}


def make(
    name: str,
    random: np.random.Generator,
    effects: Sequence[Entry] = (),
    scatter: float = SCATTER,
    step: float | None = STEP,
) -> RunLog:
    """One run of our rig, as its operator would log it.

    Args:
        name: Of its profile.
        random: Source of the noise.
        effects: That the rig has, as a set-up file has them.
        scatter: Of zeta from run to run, as a share of it [-].
        step: Integrator step [s]; chosen for the run where it is None.
    """
    from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp
    from drftjax.setups.simulated_run import simulated_run
    from drftjax.simulation.statics import sinkage_under_load

    time, omega = PROFILES[name]
    setup = SetUp(
        command=CommandSetUp([float(t) for t in time], [float(w) for w in omega], None, "deg/s"),
        integrator=IntegratorSetUp(step=step),
        title=f"example run {name}, made by simulation",
    )
    setup.effects.extend(effects)
    zeta = ZETA * (1 + scatter * random.standard_normal())
    setup.terrain.zeta = zeta
    setup.start.sinkage = float(sinkage_under_load(setup.trial().simulator, zeta))
    run = simulated_run(setup, interval=1 / RATE)

    def read(values: np.ndarray) -> np.ndarray:
        noisy = values + NOISE * random.standard_normal(len(values))
        return COUNT * np.round(noisy / COUNT)

    assert run.measured.x is not None
    assert run.measured.z is not None
    measured = Measured(time=run.measured.time, x=read(run.measured.x), z=read(run.measured.z))
    believed = type(run.setup)(**{**run.setup.known(), "scaling_factor_initial": 0.7823})
    return RunLog(
        setup=believed,
        command=run.command,
        measured=measured,
        source="virtual rig",
        title=run.title,
        notes="made by python -m tests.studies.example_runs; the true zeta is not written here",
    )


def main() -> None:
    configure_jax()
    FOLDER.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(SEED)
    for name in PROFILES:
        write_run(FOLDER / f"{name}.h5", make(name, random))
        print(FOLDER / f"{name}.h5")


if __name__ == "__main__":
    main()
