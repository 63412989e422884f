"""Table of docs/theory/integrator.md: ways to represent rest, beside another implementation.

    python -m tests.studies.rest

The reference rigs are by another implementation and lie in ../shared.
"""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax import configure_jax
from drftjax.physics import implicit
from drftjax.physics.integrator import ImplicitEuler
from drftjax.physics.state import Output
from drftjax.simulation.trial import Trial
from tests.drftjax.simulation.test_reference_rigs import recorded

RIGS = Path(__file__).parents[3] / "shared" / "reference_rigs"
STEP, FINE = 1e-2, 6.25e-4


class WholeLoad(ImplicitEuler):
    """A plate at rest along its normal carries its whole load on a rolling wheel, too."""

    def lead_speed(self, radius: Float[Array, ""], omega: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.zeros_like(omega)


WAYS = {
    "0.6 µm/s, whole load": WholeLoad(rolling=0.0),
    "0.1 mm/s, whole load": WholeLoad(standing=8.24e-5, rolling=0.0),
    "0.1 % of the rim's speed, whole load": WholeLoad(rolling=1e-3),
    "0.4 %, whole load": WholeLoad(rolling=4e-3),
    "0.1 %, half of it": ImplicitEuler(rolling=1e-3),
    "0.3 %, half of it (the default)": ImplicitEuler(),
    "0.4 %, half of it": ImplicitEuler(rolling=4e-3),
    "1 %, half of it": ImplicitEuler(rolling=1e-2),
}


def run(name: str, way: ImplicitEuler, step: float) -> tuple[Output, float, np.ndarray, float]:
    """A reference rig.

    Returns:
        Output; mean number of evaluations of the force a step; difference of z [m] from the other
        implementation at its rows; and that of the final x [m].
    """
    setup, log = recorded(RIGS, name)
    setup.integrator.step = step
    trial = setup.trial()
    trial = eqx.tree_at(lambda t: t.simulator, trial, replace(trial.simulator, integrator=way))
    counts: list[int] = []
    search = implicit.newton

    def counted(balance, guess, settings):
        root = search(balance, guess, settings)
        jax.debug.callback(lambda number: counts.append(int(number)), root.evaluations)
        return root

    implicit.newton = counted
    try:
        output = eqx.filter_jit(lambda trial: Trial.run(trial))(trial)
        jax.effects_barrier()
    finally:
        implicit.newton = search
    time = log.measured.time
    z, x = (np.interp(time, output.time, each) for each in (output.z, output.x))
    assert log.measured.z is not None
    assert log.measured.x is not None
    return output, float(np.mean(counts)), z - log.measured.z, float(x[-1] - log.measured.x[-1])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print the table."""
    configure_jax()
    heads = (
        "width at rest, load of a plate there", "evaluations a step at 10 ms",
        "z by the step, RMS [mm]", "paper, z [mm]", "plain_wheel, z [mm]", "its final x [mm]",
        "creep in a minute [mm]",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |")
    print("|---|" + "--:|" * (len(heads) - 1))
    for name, way in WAYS.items():
        coarse, evaluations, _, _ = run("paper", way, STEP)
        fine, _, paper, _ = run("paper", way, FINE)
        _, _, plain, place = run("plain_wheel", way, FINE)
        still = run("standing_60s", way, STEP)[0]
        by_step = np.asarray(coarse.z) - np.interp(coarse.time, fine.time, fine.z)
        print(
            f"| {name} | {evaluations:.1f} | {1e3 * rms(by_step):.3f} | {1e3 * rms(paper):.3f} | "
            f"{1e3 * rms(plain):.3f} | {1e3 * place:+.2f} | "
            f"{1e3 * float(still.z[0] - still.z[-1]):.3f} |"
        )


if __name__ == "__main__":
    main()
