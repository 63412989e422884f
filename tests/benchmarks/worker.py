"""Our side of the benchmark, in a process of its own: precision and flags are set once for all.

Reads one request a line on standard input and answers each with a line of JSON.
"""

import json
import math
import sys
import time
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from drftjax.physics.command import command_at
from drftjax.physics.state import State
from drftjax.physics.stress import Dynamic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.ensemble import simulate_ensemble
from drftjax.simulation.rollout import simulate, step_times
from drftjax.simulation.simulator import Simulator
from tests.benchmarks.cases import DURATION, PAPER_ZETA, ZETAS, Case

# Deep enough for the lightest sand of the cases, and half of the wheel is left out.
REACH = math.pi / 3

PROFILE = ((0.0, 2.0, 7.0, 17.0, 22.0, 24.0), (0.0, 0.0, 1.0, 1.0, 0.0, 0.0))


def commands(dt: float):
    knots, share = (jnp.asarray(values, float) for values in PROFILE)
    return command_at(step_times(round(DURATION / dt), dt), knots, share * math.pi / 6)


def simulator(case: Case, zeta, inertial=1.1) -> Simulator:
    wheel = GrouserWheel(plate_size=case.plate_size, reach=REACH)
    terrain = Terrain(ConstantZeta(zeta), Dynamic(inertial_coefficient=inertial))
    return Simulator(wheel, terrain)


def heights(case: Case, zeta, inertial=1.1):
    """z [m] at the end of every row; `zeta` a number, or one for each run."""
    rows = commands(case.dt)
    if jnp.ndim(zeta) == 0:
        start = State.at_rest(0.0176)
        return simulate(simulator(case, zeta, inertial), start, rows, case.dt, every=case.every)[
            1
        ].z
    simulators = eqx.filter_vmap(lambda zeta: simulator(case, zeta))(zeta)
    starts = eqx.filter_vmap(State.at_rest)(jnp.full(zeta.shape, 0.0176))
    return simulate_ensemble(simulators, starts, rows, case.dt, every=case.every)[1].z


def zetas(case: Case):
    if case.runs == 1:
        return jnp.asarray(PAPER_ZETA, float)
    step = (len(ZETAS) - 1) // (case.runs - 1)
    return jnp.asarray(ZETAS[::step], float)


def plain(case: Case):
    return lambda zeta: heights(case, zeta)


def forward(case: Case):
    """z of every row and its derivatives by zeta and lambda."""

    def both(zeta):
        at = (zeta, jnp.asarray(1.1, float))
        value, along = jax.linearize(lambda *numbers: heights(case, *numbers), *at)
        one, nought = jnp.ones(()), jnp.zeros(())
        return value, along(one, nought), along(nought, one)

    return both


def forward_batched(case: Case):
    """The same derivatives in one pass of two tangents."""
    return lambda zeta: jax.jacfwd(lambda numbers: heights(case, *numbers))(
        jnp.stack([zeta, jnp.asarray(1.1, float)])
    )


def reverse(case: Case):
    """A fit's loss and its gradient by zeta and lambda."""

    def both(zeta):
        at = (zeta, jnp.asarray(1.1, float))
        loss = lambda numbers: jnp.mean((heights(case, *numbers) + 0.03) ** 2)  # noqa: E731
        return jax.value_and_grad(loss)(at)

    return both


KINDS = {"plain": plain, "forward": forward, "batched": forward_batched, "reverse": reverse}


@cache
def compiled(kind: str, case: Case):
    return jax.jit(KINDS[kind](case)).lower(zetas(case)).compile()


def answer(request: dict[str, Any]) -> dict[str, Any]:
    case = Case(**request["case"])
    program = compiled(request["kind"], case)
    argument = zetas(case)
    start = time.perf_counter()
    result = jax.block_until_ready(program(argument))
    seconds = time.perf_counter() - start
    reply: dict[str, Any] = {"seconds": seconds, "devices": jax.device_count()}
    if request.get("detail"):
        leaves = [np.asarray(leaf, float) for leaf in jax.tree.leaves(result)]
        reply["finite"] = all(bool(np.isfinite(leaf).all()) for leaf in leaves)
        reply["z"] = leaves[0].tolist()
        reply["plates"] = int(simulator(case, PAPER_ZETA).wheel.cut().plates(jnp.zeros(())).x.size)
        analysis = program.memory_analysis()
        reply["memory"] = analysis.temp_size_in_bytes if analysis else None
    return reply


def main() -> None:
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
