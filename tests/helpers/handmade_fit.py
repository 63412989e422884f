"""A fit made by hand: what its report shows, without fitting."""

import numpy as np

from drftjax.setups.setup import read_setup
from identify.results.result import FitResult
from identify.results.values import RunFit, Value


def handmade_fit(names: list[str], samples: int = 800) -> FitResult:
    """Fit of runs with these names, each with a zeta of its own and one lambda.

    Args:
        names: Of the runs.
        samples: Of each run.
    """
    random = np.random.default_rng(5)
    setup = read_setup("data/paper.toml")
    time = np.linspace(0.0, 20.0, samples)
    runs = []
    for number, name in enumerate(names):
        true = np.array([0.012 * time, -0.014 - 0.002 * np.tanh(time / 3)])
        recorded = true + random.standard_normal(true.shape) * 4e-5
        values = {"zeta": Value(0.7 + 0.01 * number, 0.002, "-", "zeta")}
        counts = np.ones(samples, bool)
        before = true + np.array([[2e-3], [1e-3]]) * time / 20
        runs.append(RunFit(name, setup, values, time, counts, ("x", "z"), recorded, before, true))
    return FitResult(
        shared={"lambda": Value(1.12, 0.03, "-", "lambda")},
        runs=runs,
        status="converged",
        steps=7,
        failures={"lost.h5": "it holds no sinkage"},
        findings=["lambda and zeta cannot be told apart by runs of one speed"],
        floors={"x": 4e-5, "z": 4e-5},
    )
