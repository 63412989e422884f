"""Of docs/theory/integrator.md: error of a run by its step, how little zeta changes it, and lambda.

python -m tests.studies.step_error
"""

from pathlib import Path
from unittest import mock

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from drftjax.common.jax_config import configure_jax
from drftjax.recorded.prepared_run import RECORDED_STEPS
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.simulation.statics import sinkage_under_load
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.step_error import step_error
from drftjax.simulation.trial import Trial
from identify.api import fit
from identify.solver.problem import Problem

EXAMPLES = Path(__file__).parents[2] / "data" / "runs"
ZETA, OTHER = 0.7823, 0.73
# Top speed [deg/s], and the times of the ramps [s].
PROFILES = {
    20: [0, 2, 7, 17, 22, 24],
    30: [0, 2, 7, 17, 22, 24],
    90: [0, 1, 4, 9, 12, 13],
    240: [0, 1, 3, 6, 8, 9],
}


@eqx.filter_jit
def _place(trial: Trial) -> jnp.ndarray:
    return trial.run_to(jnp.asarray(trial.rows), ("x", "z"))


def error_at(
    zeta: float, speed: float, times: list[float], step: float | None = None
) -> tuple[float, np.ndarray]:
    """The step [s], chosen where none is given, and the error of x and z by it, (2, rows) [m]."""
    setup = SetUp(command=CommandSetUp(times, [0, 0, speed, speed, 0, 0], None, "deg/s"))
    setup.terrain.zeta = zeta
    setup.start.sinkage = float(sinkage_under_load(setup.trial().simulator, zeta))
    setup.integrator.step = (
        choose_step(setup.trial(), RECORDED_STEPS).step if step is None else step
    )
    trial = setup.trial(interval=0)

    def simulated(parts: np.ndarray) -> np.ndarray:
        return np.asarray(_place(eqx.tree_at(lambda t: t.parts, trial, jnp.asarray(parts))))

    return float(trial.step), step_error(simulated, trial)


def rms(values: np.ndarray) -> str:
    return " | ".join(f"{1e3 * size:.3f}" for size in np.sqrt(np.mean(values**2, axis=1)))


def fitted_lambda() -> str:
    """Lambda of the example runs, and its error."""
    found = fit([*sorted(EXAMPLES.glob("*.h5"))]).shared["terrain.inertial_coefficient"]
    return f"{found.value:.3f} ± {found.error:.3f}"


def main() -> None:
    """Print the table, and lambda with and without the correction."""
    configure_jax()
    print("| speed [deg/s] | step [ms] | x [mm] | z [mm] | left in x [mm] | left in z [mm] |")
    print("|--:|--:|--:|--:|--:|--:|")
    for speed, times in PROFILES.items():
        step, here = error_at(ZETA, speed, times)
        _, there = error_at(OTHER, speed, times, step)
        print(f"| {speed} | {1e3 * step:g} | {rms(here)} | {rms(here - there)} |")
    print(f"lambda of data/runs: {fitted_lambda()}")
    with mock.patch.object(Problem, "without_step_error", lambda problem, _: problem):
        print(f"with the step's error left in: {fitted_lambda()}")


if __name__ == "__main__":
    main()
