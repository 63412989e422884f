"""Table of docs/theory/integrator.md: the step that each reference rig takes, and its true error.

    python -m tests.studies.step

The reference rigs are by another implementation and lie in ../shared.
"""

from pathlib import Path

import equinox as eqx
import numpy as np

from drftjax import configure_jax
from drftjax.simulation.trial import Trial
from tests.drftjax.simulation.test_reference_rigs import NAMES, choice_for, recorded

RIGS = Path(__file__).parents[3] / "shared" / "reference_rigs"


def rows() -> list[str]:
    """One line of a Markdown table for each rig."""
    run = eqx.filter_jit(Trial.run)
    lines = []
    for name in NAMES:
        setup, log = recorded(RIGS, name)
        choice = choice_for(setup)
        setup.integrator.step = choice.step
        output = run(setup.trial())
        time = log.measured.time
        z = np.interp(time, output.time, output.z) - log.measured.z
        x = float(np.interp(time[-1], output.time, output.x) - log.measured.x[-1])
        lines.append(
            f"| {name} | {1e3 * choice.step:g} | {1e3 * choice.sinkage_error:.3f} | "
            f"{1e3 * np.sqrt(np.mean(z**2)):.3f} | {1e3 * choice.travel_error:.2f} | "
            f"{1e3 * x:+.2f} | {100 * choice.slope_error:.1f} |"
        )
    return lines


if __name__ == "__main__":
    configure_jax()
    print(
        "| rig | step [ms] | z, estimated [mm] | z [mm] | x, estimated [mm] | x [mm] | slope [%] |"
    )
    print("|---|---|---|---|---|---|---|")
    print("\n".join(rows()))
