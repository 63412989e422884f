"""Does a designed run keep its promise? Noisy runs of two profiles, fitted, against the promise.

drft design data/paper.toml --parameter lambda --max-speed 300 -o out/design
python -m tests.studies.design data/paper.toml out/design.toml
"""

import argparse
import math
import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import Measured
from drftjax.setups.setup import SetUp, read_setup
from drftjax.setups.simulated_run import simulated_run
from identify.design.design import evaluate_setup
from identify.fit_constant import fit
from identify.parameters.parameter import parameter

NOISE = {"x": 5e-5, "z": 2e-5}


def fitted(setup: SetUp, seeds: int, start_known: bool = True) -> np.ndarray:
    """lambda as fitted beside zeta to noisy runs of a set-up, one for each seed.

    Args:
        setup: What is simulated, and fitted with the same integrator.
        seeds: Number of runs.
        start_known: Whether the fit is told where the run starts; else it takes the mean of the
            first samples, as fits of recorded runs do.
    """
    clean = simulated_run(setup)
    candidates = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        time = clean.measured.time
        noisy = {
            name: getattr(clean.measured, name) + random.normal(0, sd, len(time))
            for name, sd in NOISE.items()
        }
        run = replace(clean, measured=Measured(time=time, **noisy))
        each = prepare_run(f"seed_{seed}", run, step=setup.integrator.step)
        if start_known:
            known = setup.trial(5 * setup.integrator.step)
            each = replace(each, setup=setup, trial=known)
        candidates.append(each)
    result = fit(candidates, [parameter(name, shared=False) for name in ("zeta", "lambda")])
    return np.array([run.values["terrain.inertial_coefficient"].value for run in result.runs])


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", os.cpu_count())
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("setups", nargs="+", type=Path)
    parser.add_argument("--seeds", type=int, default=8)
    chosen = parser.parse_args()
    for path in chosen.setups:
        option = evaluate_setup(read_setup(path), "lambda", ["zeta"])
        for start_known in (True, False):
            values = fitted(option.setup, chosen.seeds, start_known)
            spread = values.std(ddof=1)
            print(
                f"{path.name:12s} start {'known' if start_known else 'as recorded':12s} "
                f"promised {option.information.error:.3g}, scatter {spread:.3g} "
                f"± {spread / math.sqrt(2 * (len(values) - 1)):.1g}, "
                f"mean {values.mean():.5g} of {option.information.value:g}",
                flush=True,
            )


if __name__ == "__main__":
    main()
