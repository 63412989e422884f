"""What plates half as long would change of the runs: the simulation's own error, or most of it.

Sand knows of no plates, and a wheel that is cut into others travels otherwise by some hundredths or
tenths of a millimetre, more at speed. No gap of that size tells of a rig.
"""

from dataclasses import replace

import equinox as eqx
import msgspec
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import AugmentedModel, predict
from diagnose.run_pool import RunPool
from drftjax.recorded.prepared_run import PreparedRun

FINER = 2


# How far apart two zetas are [of a logarithm] between which a run's own is found: sinkage bends
# little over so much, and moves by far more than a plate makes it.
APART = 0.01


def discretization_errors(
    case: RigDataset, log_zeta: np.ndarray, pool: RunPool
) -> dict[str, float]:
    """RMS of what finer plates change in each channel [m, N, N m], at the same mean sinkage.

    Args:
        case: The runs.
        log_zeta: Each run's log zeta over its set-up's, shape (runs,).
        pool: Threads.
    """
    finer = [residuals_on_finer_plates(each) for each in case.runs]
    fine = RigDataset.of(finer, case.settings)
    plain, nothing = AugmentedModel(), np.zeros(0)
    fine.precompile(pool, predict, [plain])
    z = case.channels.index("z")

    def of(run: int) -> np.ndarray:
        coarse = case.prediction(plain, run, log_zeta[run], nothing)
        here, there = (
            fine.prediction(plain, run, log_zeta[run] + more, nothing) for more in (0.0, APART)
        )
        # Each has the zeta that meets the run, so both are held against each other at that.
        share = (coarse - here)[z].mean() / (there - here)[z].mean()
        return here + share * (there - here) - coarse

    # A run that finer plates throw off the sand tells nothing of those it was simulated by.
    kept = [each for each in pool.map(of, case.run_numbers) if np.isfinite(each).all()]
    changes = np.concatenate(kept or [np.zeros((len(case.channels), 1))], axis=1)
    return dict(zip(case.channels, np.sqrt(np.mean(changes**2, axis=1)).tolist(), strict=True))


def residuals_on_finer_plates(candidate: PreparedRun) -> PreparedRun:
    """A run whose wheel is cut into plates half as long."""
    wheel = candidate.setup.wheel
    wheel = msgspec.structs.replace(wheel, plate_size=wheel.plate_size / FINER)
    return replace(
        candidate,
        setup=msgspec.structs.replace(candidate.setup, wheel=wheel),
        trial=eqx.tree_at(lambda t: t.simulator.wheel, candidate.trial, wheel.build()),
    )
