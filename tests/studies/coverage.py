"""How often nominal 90 % intervals hold the truth: `python -m tests.studies.coverage`.

Batches of two short runs are simulated with zeta and lambda drawn anew, and recorded with the noise
that a fit supposes: white, and a constant in every phase of the command that the simulation may be
off by. Each batch is fitted from the same start.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
ZETA, LAMBDA = "terrain.zeta", "terrain.inertial_coefficient"
NINETY = 1.645
# Knots in time [s] and omega [rad/s]: fast enough that lambda matters.
BRISK = ([0.0, 0.25, 1.05, 1.6], [0.0, 0.0, 2.0, 2.0])
STEP = 5e-4


@dataclasses.dataclass(frozen=True)
class Coverage:
    """What a number of batches gave.

    Attributes:
        off: (fitted - true) / standard error, by parameter.
    """

    off: dict[str, np.ndarray]

    def share(self, name: str, width: float = NINETY) -> float:
        """Share of the intervals of so many standard errors either way that hold the truth."""
        return float(np.mean(np.abs(self.off[name]) <= width))

    def __str__(self) -> str:
        return "\n".join(
            f"{name}: {len(off)} intervals, {100 * self.share(name):.1f} % hold the truth, "
            f"(fitted - true) / error has mean {off.mean():+.2f} and spread {off.std():.2f}"
            for name, off in self.off.items()
        )


def coverage(
    batches: int, offsets: bool = True, seed: int = 0, report=None, step: float = STEP
) -> Coverage:
    """Fit `batches` of two runs whose truth is known.

    Args:
        batches: How many.
        offsets: Whether each phase is off by a constant, and the fit supposes so.
        seed: Of truths and noise.
        report: Called with the number of the batch.
        step: Of the simulations and the fits [s].
    """
    from identify.fit_constant import MODEL_ERROR, fit
    from identify.parameters.parameter import own, shared

    random = np.random.default_rng(seed)
    error = MODEL_ERROR if offsets else {}
    off: dict[str, list[float]] = {ZETA: [], LAMBDA: []}
    for batch in range(batches):
        zetas, factor = 0.75 + 0.02 * random.standard_normal(2), random.uniform(0.8, 1.4)
        candidates = [
            _run(f"run {n}", zeta, factor, random, error, step) for n, zeta in enumerate(zetas)
        ]
        result = fit(candidates, [own("zeta"), shared("lambda")], model_error=error)
        for run, zeta in zip(result.runs, zetas, strict=True):
            off[ZETA].append((run.values[ZETA].value - zeta) / run.values[ZETA].error)
        value = result.shared[LAMBDA]
        off[LAMBDA].append((value.value - factor) / value.error)
        if report:
            report(batch + 1)
    return Coverage({name: np.array(values) for name, values in off.items()})


def _run(name: str, zeta: float, factor: float, random, error, step: float):
    from drftjax.runlog.record import Measured
    from identify.uncertainty.estimate import phases_of
    from tests.helpers.synthetic_runs import coarse, recorded, setup_of

    setup = setup_of(BRISK, zeta)
    setup.terrain.inertial_coefficient = factor
    setup.integrator.step = step
    run = recorded(setup, int(random.integers(2**31)))
    each = coarse(name, run, step=step)
    counts = np.ones((1, 1, len(run.measured.time)), bool)
    (phase,) = phases_of((each,), counts)
    channels = {}
    for channel, values in run.measured.channels().items():
        constants = error.get(channel, 0.0) * random.standard_normal(phase.max() + 1)
        channels[channel] = values + constants[phase]
    moved = dataclasses.replace(run, measured=Measured(time=run.measured.time, **channels))
    return coarse(name, moved, step=step)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--batches", type=int, default=200)
    arguments.add_argument("--white", action="store_true", help="no constants in the phases")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    sys.path.insert(0, str(ROOT))
    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=1)
    begin = time.perf_counter()

    def report(batch: int) -> None:
        if batch % 20 == 0:
            print(f"{batch} batches in {time.perf_counter() - begin:.0f} s", flush=True)

    print(coverage(given.batches, not given.white, given.seed, report))


if __name__ == "__main__":
    main()
