"""Discretisation error: the change of the simulated runs with finer numerics.

Sand has no plates, and no width at rest. With plates half as long, which begin to lead over half
the width, a simulated wheel moves otherwise by some hundredths or tenths of a millimetre, more at
high speed. A gap of that size is no property of the rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import msgspec
import numpy as np

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import AugmentedModel, predict
from diagnose.model.linearized_run import FORCES
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
        max_share: Share of the change of the forces that is held against no model, at most [-]: on
            from plates half as long to none at all, by an error of first order.
    """

    refinement: int = 2
    log_zeta_step: float = 0.01
    max_share: float = 2.0


DEFAULT_DISCRETIZATION = DiscretizationSettings()


def changes_with_finer_plates(
    dataset: RigDataset,
    log_zeta: np.ndarray,
    pool: RunPool,
    settings: DiscretizationSettings = DEFAULT_DISCRETIZATION,
) -> list[np.ndarray]:
    """By run, change of each channel with finer numerics, at the same mean sinkage [m, N, N m].

    Args:
        dataset: The runs.
        log_zeta: Each run's log zeta over its set-up's [-], shape (runs,).
        pool: Threads.
        settings: Numbers of the comparison.

    Returns:
        Each of shape (channels, samples); not finite where they throw a run off the sand.
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

    return dataset.map(pool, change)


def discretization_errors(dataset: RigDataset, changes: Sequence[np.ndarray]) -> dict[str, float]:
    """RMS change of each channel with finer numerics, by channel [m, N, N m].

    Args:
        dataset: The runs.
        changes: By `changes_with_finer_plates`; runs without finite ones are left out.
    """
    kept = [each for each in changes if np.isfinite(each).all()]
    together = np.concatenate(kept or [np.zeros((len(dataset.channels), 1))], axis=1)
    return dict(zip(dataset.channels, np.sqrt(np.mean(together**2, axis=1)).tolist(), strict=True))


def beside_plates(
    dataset: RigDataset,
    residual: Sequence[np.ndarray],
    changes: Sequence[np.ndarray],
    settings: DiscretizationSettings = DEFAULT_DISCRETIZATION,
) -> list[np.ndarray]:
    """Residuals less what the length of the plates makes of forces and torque.

    A plate begins to bear at once, so the longer plates are, the later comes the ripple of the
    forces: by some milliseconds, as a delay of the instruments would have it. x and z follow the
    forces too slowly to show it, and stay as they are. One share of the changes is taken for all
    runs: none for a rig with plates as long, 1 for half as long, and about 2 for sand, which has
    none.

    Args:
        dataset: The runs.
        residual: By run, simulated minus recorded [m, N, N m], shape (channels, samples).
        changes: By `changes_with_finer_plates`.
        settings: The largest share.
    """
    rows = np.array([name in FORCES for name in dataset.channels])[:, None]
    known = [np.where(rows & np.isfinite(each), each, 0.0) for each in changes]
    power = sum(float((each**2).sum()) for each in known)
    if power == 0:
        return list(residual)
    pairs = list(zip(residual, known, strict=True))
    common = sum(float(np.nansum(left * change)) for left, change in pairs)
    share = float(np.clip(-common / power, 0.0, settings.max_share))
    return [left + share * change for left, change in pairs]


def of_positions(dataset: RigDataset, changes: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Changes of x and z alone; those of forces and torque, and what is not finite, are zero.

    Args:
        dataset: The runs.
        changes: By `changes_with_finer_plates`.
    """
    rows = np.array([name not in FORCES for name in dataset.channels])[:, None]
    return [np.where(rows & np.isfinite(each), each, 0.0) for each in changes]


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
    wheel = msgspec.structs.replace(wheel, plate_size=wheel.plate_length / settings.refinement)
    return replace(
        run,
        setup=msgspec.structs.replace(run.setup, wheel=wheel),
        trial=eqx.tree_at(
            lambda t: (t.simulator.wheel, t.simulator.integrator),
            run.trial,
            (wheel.build(), replace(integrator, rolling=integrator.rolling / settings.refinement)),
        ),
    )
