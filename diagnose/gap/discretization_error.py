"""Discretisation error: the change of the simulated runs with finer numerics.

Sand has no plates, and no width at rest. With plates half as long, which begin to lead over half
the width, a simulated wheel moves otherwise by some hundredths or tenths of a millimetre, more at
high speed. A gap of that size is no property of the rig.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import msgspec
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import AugmentedModel, predict
from diagnose.run_pool import RunPool
from drftjax.recorded.prepared_run import PreparedRun


@dataclass(frozen=True)
class DiscretizationSettings:
    """Numbers of the comparison with finer numerics.

    Attributes:
        refinement: Finer plates per plate, and share of the width at rest.
        log_zeta_step: Difference between two log zetas [-], between which and beyond the response
            is taken as linear: sinkage bends little over so much, and changes by far more than the
            plates change it.
    """

    refinement: int = 2
    log_zeta_step: float = 0.01


DEFAULT_DISCRETIZATION = DiscretizationSettings()


def discretization_errors(
    dataset: RigDataset,
    log_zeta: np.ndarray,
    pool: RunPool,
    settings: DiscretizationSettings = DEFAULT_DISCRETIZATION,
) -> dict[str, float]:
    """RMS change of each channel with finer numerics, at the same mean sinkage [m, N, N m].

    Args:
        dataset: The runs.
        log_zeta: Each run's log zeta over its set-up's [-], shape (runs,).
        pool: Threads.
        settings: Numbers of the comparison.

    Returns:
        By channel; runs that they throw off the sand are left out.
    """
    finer = [with_finer_plates(each, settings) for each in dataset.runs]
    fine = RigDataset.of(finer, dataset.settings)
    model, nothing = AugmentedModel(), np.zeros(0)
    fine.compile(pool, predict, model)
    z = dataset.channels.index("z")

    def change(run: int) -> np.ndarray:
        coarse = dataset.prediction(model, run, log_zeta[run], nothing)
        here, there = (
            fine.prediction(model, run, log_zeta[run] + step, nothing)
            for step in (0.0, settings.log_zeta_step)
        )
        # Zeta is fitted to each run's sinkage, so the comparison is made at equal mean sinkage.
        share = (coarse - here)[z].mean() / (there - here)[z].mean()
        return here + share * (there - here) - coarse

    kept = [each for each in dataset.map(pool, change) if np.isfinite(each).all()]
    changes = np.concatenate(kept or [np.zeros((len(dataset.channels), 1))], axis=1)
    return dict(zip(dataset.channels, np.sqrt(np.mean(changes**2, axis=1)).tolist(), strict=True))


def zeta_response(
    dataset: RigDataset,
    run: int,
    log_zeta: float,
    settings: DiscretizationSettings = DEFAULT_DISCRETIZATION,
) -> np.ndarray:
    """Derivative of a run's channels by its log zeta, by a forward difference [m, N, N m].

    Args:
        dataset: The runs.
        run: Index of the run.
        log_zeta: Logarithm of its zeta over its set-up's [-].
        settings: Its step.

    Returns:
        Shape (channels, samples).
    """
    model, nothing = AugmentedModel(), np.zeros(0)
    here, there = (
        dataset.prediction(model, run, at, nothing)
        for at in (log_zeta, log_zeta + settings.log_zeta_step)
    )
    return (there - here) / settings.log_zeta_step


def with_finer_plates(
    run: PreparedRun, settings: DiscretizationSettings = DEFAULT_DISCRETIZATION
) -> PreparedRun:
    """The run with its wheel cut into finer plates, which begin to lead over a smaller width."""
    wheel, integrator = run.setup.wheel, run.trial.simulator.integrator
    wheel = msgspec.structs.replace(wheel, plate_size=wheel.plate_size / settings.refinement)
    return replace(
        run,
        setup=msgspec.structs.replace(run.setup, wheel=wheel),
        trial=eqx.tree_at(
            lambda t: (t.simulator.wheel, t.simulator.integrator),
            run.trial,
            (wheel.build(), replace(integrator, rolling=integrator.rolling / settings.refinement)),
        ),
    )
