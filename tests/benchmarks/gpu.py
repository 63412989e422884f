"""Measure ensembles on an accelerator: `python -m tests.benchmarks.gpu [--most 1000000]`.

Ten to a million runs of the paper's 24 s profile in float32, under one `vmap` (in parts that fit
the memory), with zeta from 0.6 to 1. z and the final x of sixteen of them are held against float64
with a quarter of the step on the CPU.
"""

import argparse
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.arrays import as_real
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.speed import SINKAGE, TIMES, profile
from tests.benchmarks.cases import DRIVEN, STOPS, checked, zetas_of
from tests.benchmarks.worker import REACH

STEP, ROW = 1e-2, 0.1
FINE = STEP / 4
# Runs that are computed at once: a row of 240 outputs each, and the steps' own memory.
PART = 131_072


@partial(jax.jit, static_argnums=1)
def heights(zeta: jax.Array, step: float) -> tuple[jax.Array, jax.Array]:
    """z at every row and the last x [m] of runs, shape (runs, rows) and (runs,).

    Args:
        zeta: Of each run, shape (runs,).
        step: [s].
    """
    commands = profile(step)

    def one(zeta: jax.Array) -> tuple[jax.Array, jax.Array]:
        simulator = Simulator(GrouserWheel(reach=REACH), Terrain(ConstantZeta(zeta)))
        start = State.at_rest(SINKAGE)
        output = simulate(simulator, start, commands, step, every=round(ROW / step))[1]
        return output.z, output.x[-1]

    return eqx.filter_vmap(one)(zeta)


def in_parts(runs: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Time [s] that the runs take, and z and x of those that are checked."""
    zetas, kept = zetas_of(runs), checked(runs)
    size = min(runs, PART)
    jax.block_until_ready(heights(as_real(zetas[:size]), STEP))
    z, x = [], []
    start = time.perf_counter()
    for first in range(0, runs, size):
        # The last part is filled up, so that all share one program.
        rows = np.minimum(np.arange(first, first + size), runs - 1)
        made = jax.block_until_ready(heights(as_real(zetas[rows]), STEP))
        mine = kept[(kept >= first) & (kept < first + size)] - first
        z.append(np.asarray(made[0][mine]))
        x.append(np.asarray(made[1][mine]))
    return time.perf_counter() - start, np.concatenate(z), np.concatenate(x)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure ensembles on an accelerator.")
    parser.add_argument("--most", type=int, default=1_000_000, help="runs of the largest ensemble")
    most = parser.parse_args().most
    console, table = Console(), Table()
    for heading in ("runs", "seconds", "runs a second", "error of z [mm]", "of the final x [mm]"):
        table.add_column(heading, justify="right")
    times = ROW * np.arange(1, round(TIMES[-1] / ROW) + 1)
    driven = (times >= DRIVEN) & (times <= STOPS)
    for power in range(1, 7):
        runs = 10**power
        if runs > most:
            break
        seconds, z, x = in_parts(runs)
        with jax.default_device(jax.devices("cpu")[0]), jax.enable_x64(True):
            fine = heights(jnp.asarray(zetas_of(runs)[checked(runs)], jnp.float64), FINE)
        fine_z, fine_x = (np.asarray(each) for each in fine)
        table.add_row(
            f"{runs:,}", f"{seconds:.3g}", f"{runs / seconds:,.0f}",
            f"{1e3 * np.abs(z - fine_z)[:, driven].max():.3f}",
            f"{1e3 * np.abs(x - fine_x).max():.2f}",
        )  # fmt: skip
    console.print(f"{jax.devices()[0].device_kind}, JAX {jax.__version__}, float32, {STEP:g} s")
    console.print(table)


if __name__ == "__main__":
    main()
