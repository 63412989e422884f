"""What each effect costs: its step's time over the plain step's, on the paper's 24 s at 1 ms.

    python -m tests.benchmarks.effects          # a Markdown table

The runs with and without an effect take turns, and the shortest of several runs counts, so that
other work on the machine shows little.
"""

import argparse
import time
from dataclasses import replace

from drftjax.common.jax_config import configure_jax

configure_jax()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

from drftjax.effects.catalogue import catalogue  # noqa: E402
from drftjax.effects.serialization import typical_effect  # noqa: E402
from drftjax.physics.command import command_at  # noqa: E402
from drftjax.physics.state import State  # noqa: E402
from drftjax.simulation.rollout import simulate, step_times  # noqa: E402
from drftjax.simulation.simulator import Simulator  # noqa: E402

KNOTS = (0.0, 2.0, 7.0, 17.0, 22.0, 24.0)
OMEGA = (0.0, 0.0, 0.5236, 0.5236, 0.0, 0.0)
STEP, EVERY = 1e-3, 20


def program(effects):
    """A compiled run with these effects, and its arguments."""
    simulator = replace(Simulator(), effects=tuple(effects))
    steps = step_times(round(KNOTS[-1] / STEP), STEP)
    commands = command_at(steps, jnp.asarray(KNOTS), jnp.asarray(OMEGA))

    def run(simulator):
        rows = simulate(simulator, State.at_rest(0.0176), commands, STEP, every=EVERY)[1]
        return rows.x, rows.z

    return eqx.filter_jit(run).lower(simulator).compile(), simulator


def seconds(compiled, simulator) -> float:
    """Processor time of a run [s]: it keeps one core busy, and other work does not count."""
    start = time.process_time()
    jax.block_until_ready(compiled(simulator))
    return time.process_time() - start


def cost(effects, plain, repeats: int) -> tuple[float, float]:
    """Shortest times [s] of a run with these effects and of one without, taken in turns."""
    with_effects = program(effects)
    pairs = [(seconds(*with_effects), seconds(*plain)) for _ in range(repeats + 1)][1:]
    return min(a for a, _ in pairs), min(b for _, b in pairs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("names", nargs="*", help="effects to measure; all where none is named")
    chosen = parser.parse_args()
    # The paper's carriage is free.
    known = {name: each for name, each in catalogue().items() if name != "carriage_gain"}
    plain = program(())
    steps = KNOTS[-1] / STEP
    cases = {name: (known[name],) for name in chosen.names or known}
    if not chosen.names:
        cases["all at once"] = tuple(known.values())
    taken = {
        name: cost([typical_effect(each) for each in those], plain, chosen.repeats)
        for name, those in cases.items()
    }
    bare = min(without for _, without in taken.values())
    print("| effect | µs a step | over the plain step |\n|---|---|---|")
    print(f"| none | {bare / steps * 1e6:.2f} | 1.00 |")
    for name, (time_taken, without) in taken.items():
        # Over the plain runs made in turn with it: a machine's pace changes with the minutes.
        print(f"| {name} | {time_taken / steps * 1e6:.2f} | {time_taken / without:.2f} |")


if __name__ == "__main__":
    main()
