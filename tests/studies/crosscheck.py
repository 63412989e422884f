"""Which zeta(t) is closer to a known one: the online tuner's, or the offline fit's.

    python -m tests.studies.crosscheck [-o out/crosscheck]

Prints the tables of `docs/guide/crosscheck.md`. The runs are simulated by the fit's own integrator
with steps of 0.5 ms, their error taken off, and read with 20 um of noise. Some minutes.
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console

from drftjax.common.jax_config import configure_jax
from drftjax.runlog.record import Measured, RunLog
from drftjax.setups.setup import CommandSetUp, IntegratorSetUp, SetUp
from drftjax.setups.terrain_setup import ZetaKnots

SEED = 20240719
NOISE = 20e-6
RATE = 50.0
FINEST = 0.02
TIME, OMEGA = (0.0, 0.5, 2.0, 8.0, 9.5, 10.0), (0.0, 0.0, 45.0, 45.0, 0.0, 0.0)
KNOTS = 0.5
ZETA = 0.74

KnownPath = Callable[[np.ndarray], np.ndarray]


def sinusoid(amplitude: float, period: float) -> KnownPath:
    return lambda t: ZETA + amplitude * np.sin(2 * np.pi * (t - 2.0) / period) * (t > 2.0)


# Beside the tuner's slew limit, 0.1 /s at the paper's step and a tick of 10 ms.
PATHS: dict[str, KnownPath] = {
    "ramp": lambda t: np.interp(t, [3.0, 7.0], [0.78, 0.68]),  # a quarter of it
    "step": lambda t: np.interp(t, [5.0, 5.02], [0.78, 0.70]),
    "slow": sinusoid(0.04, 5.0),  # half of it
    "fast": sinusoid(0.06, 1.6),  # 2.4 times
    "faint": sinusoid(0.002, 4.0),  # 0.07 mm of sinkage, inside the dead band
}


def known_setup(
    title: str, path: KnownPath, grid: np.ndarray, time=TIME, omega=OMEGA, plate_size: float = 4e-3
) -> SetUp:
    """A set-up whose zeta is a known path's between the knots of a grid, resting at its start."""
    from drftjax.simulation.statics import sinkage_under_load

    command = CommandSetUp([*map(float, time)], [*map(float, omega)], None, "deg/s")
    setup = SetUp(command=command, title=title)
    setup.wheel.plate_size = plate_size
    first = float(path(np.zeros(1))[0])
    setup.terrain.zeta = first
    setup.start.sinkage = float(sinkage_under_load(setup.trial().simulator, first))
    setup.terrain.zeta = ZetaKnots(grid.tolist(), path(grid).tolist())
    return setup


def known_run(setup: SetUp, random: np.random.Generator, noise: float = NOISE) -> RunLog:
    """A set-up's run as a rig would log it, which believes in the paper's zeta."""
    from drftjax.setups.simulated_run import simulated_run

    run = simulated_run(setup, 1 / RATE)
    assert run.measured.x is not None
    assert run.measured.z is not None

    def read(values: np.ndarray) -> np.ndarray:
        return values + noise * random.standard_normal(len(values))

    measured = Measured(time=run.measured.time, x=read(run.measured.x), z=read(run.measured.z))
    believed = dataclasses.replace(run.setup, scaling_factor_initial=0.7823)
    return dataclasses.replace(run, measured=measured, setup=believed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", type=Path, default=Path("out/crosscheck"))
    stem = parser.parse_args().o
    configure_jax()
    from drftjax.recorded.prepared_run import prepare_run
    from identify.commands.crosscheck import write
    from identify.crosscheck.crosscheck import crosscheck
    from identify.crosscheck.replays import TunerSetting
    from identify.crosscheck.report import tables

    random = np.random.default_rng(SEED)
    grid = np.arange(0.0, TIME[-1] + FINEST / 2, FINEST)
    runs = []
    for name, path in PATHS.items():
        setup = known_setup(name, path, grid)
        setup.integrator = IntegratorSetUp(step=5e-4)
        runs.append(prepare_run(name, known_run(setup, random)))
    setting = TunerSetting(0.01, 1e-3, 1e-4)
    result = crosscheck(runs, setting, truths=PATHS, knot_spacing=KNOTS)
    console = Console(width=110)
    for table in tables(result):
        console.print(table)
    console.print(f"written: {', '.join(map(str, write(result, stem)))}")


if __name__ == "__main__":
    main()
