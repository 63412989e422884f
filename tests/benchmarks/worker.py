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

from drftjax.physics.state import State
from drftjax.physics.stress import Dynamic
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.ensemble import simulate_ensemble
from drftjax.simulation.rollout import simulate
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.speed import SINKAGE, profile
from tests.benchmarks.cases import PAPER_ZETA, Case, checked, zetas_of

# Deep enough for the lightest sand of the cases, and half of the wheel is left out.
REACH = math.pi / 3


def simulator(case: Case, zeta, inertial=1.1) -> Simulator:
    wheel = GrouserWheel(plate_size=case.plate_size, reach=REACH)
    terrain = Terrain(ConstantZeta(zeta), Dynamic(inertial_coefficient=inertial))
    return Simulator(wheel, terrain)


def places(case: Case, zeta, inertial=1.1):
    """z and the last x [m], z at the end of every row; `zeta` a number, or one for each run."""
    rows = profile(case.dt)
    if jnp.ndim(zeta) == 0:
        start = State.at_rest(SINKAGE)
        made = simulator(case, zeta, inertial)
        output = simulate(made, start, rows, case.dt, every=case.every)[1]
        return output.z, output.x[-1]
    simulators = eqx.filter_vmap(lambda zeta: simulator(case, zeta))(zeta)
    starts = eqx.filter_vmap(State.at_rest)(jnp.full(zeta.shape, SINKAGE))
    output = simulate_ensemble(simulators, starts, rows, case.dt, every=case.every)[1]
    return output.z, output.x[:, -1]


def heights(case: Case, zeta, inertial=1.1):
    """z [m] at the end of every row."""
    return places(case, zeta, inertial)[0]


def zetas(case: Case):
    if case.runs == 1:
        return jnp.asarray(PAPER_ZETA, float)
    return jnp.asarray(zetas_of(case.runs), float)


def plain(case: Case):
    return lambda zeta: places(case, zeta)


def eight_numbers(simulator: Simulator) -> list:
    law, wheel, rig = simulator.terrain.law, simulator.wheel, simulator.rig
    assert isinstance(law, Dynamic)
    assert isinstance(wheel, GrouserWheel)
    return [
        simulator.terrain.zeta.value, law.inertial_coefficient, law.bulk_density,
        law.height_decrease, wheel.radius, wheel.grouser_height, rig.mass_x, rig.mass_z,
    ]  # fmt: skip


def by_eight(case: Case):
    """z of every row, and its derivatives by the logarithms of eight numbers."""

    def both(zeta):
        plain = simulator(case, zeta)

        def path(logarithms):
            values = eight_numbers(plain)
            changed = [v * jnp.exp(by) for v, by in zip(values, logarithms, strict=True)]
            made = eqx.tree_at(eight_numbers, plain, changed)
            start, commanded = State.at_rest(SINKAGE), profile(case.dt)
            z = simulate(made, start, commanded, case.dt, every=case.every)[1].z
            return z, z

        jacobian, z = jax.jacfwd(path, has_aux=True)(jnp.zeros(len(eight_numbers(plain))))
        return z, jacobian

    return both


def reverse(case: Case):
    """A fit's loss and its gradient by zeta and lambda."""

    def both(zeta):
        at = (zeta, jnp.asarray(1.1, float))
        loss = lambda numbers: jnp.mean((heights(case, *numbers) + 0.03) ** 2)  # noqa: E731
        return jax.value_and_grad(loss)(at)

    return both


KINDS = {"plain": plain, "eight": by_eight, "reverse": reverse}


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
        if request["kind"] == "plain":
            kept = checked(case.runs) if case.runs > 1 else slice(None)
            reply["z"] = leaves[0][kept].tolist()
            reply["x"] = np.atleast_1d(leaves[1])[kept].tolist()
        reply["plates"] = int(simulator(case, PAPER_ZETA).wheel.cut().plates(jnp.zeros(())).x.size)
        analysis = program.memory_analysis()
        reply["memory"] = analysis.temp_size_in_bytes if analysis else None
    return reply


def main() -> None:
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
