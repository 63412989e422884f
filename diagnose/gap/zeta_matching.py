"""Every run simulated at its matched zeta, at which it matches its own mean recorded sinkage.

Sand is never prepared twice alike, so each run has a zeta of its own. The zeta that fits all
channels best depends on their weights, as it may give up one channel for another. The matched zeta
depends on the mean sinkage alone, and is found in the same way for runs that no effect was fitted
to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from drftjax.recorded.matched_zeta import (
    DEFAULT_ZETA_MATCH,
    ZetaMatchSettings,
    match_mean_sinkage,
)

REFERENCE_NAME = "the reference model"
"""Name of the model without effects in reports."""

WITH_EFFECTS_NAME = "the model with the effects"
"""Name of the model with effects in reports."""


@dataclass(frozen=True, eq=False)
class MatchedRun:
    """A run simulated with its own zeta.

    Attributes:
        residual: Simulated minus recorded [m, N, N m], shape (channels, samples).
        log_zeta: Logarithm of its zeta over its set-up's [-].
        matched: True where that zeta matches the run's mean sinkage.
    """

    residual: np.ndarray
    log_zeta: float
    matched: bool


def match_runs(
    dataset: RigDataset,
    model: AugmentedModel,
    coordinates: np.ndarray,
    pool: RunPool,
    settings: ZetaMatchSettings = DEFAULT_ZETA_MATCH,
) -> list[MatchedRun]:
    """Simulate every run with a model's effects, each at its matched zeta.

    Args:
        dataset: Runs that the effects were not fitted to.
        model: The effects.
        coordinates: Their numbers, which stay, shape (numbers,).
        pool: Threads.
        settings: Numbers of the secant search.
    """
    at = np.asarray(coordinates)

    def of(run: int) -> MatchedRun:
        first = dataset.prediction(model, run, 0.0, at) - dataset.recording(run)
        start = MatchedRun(first, 0.0, matched=False)
        return match_zeta(dataset, model, run, at, start, settings=settings)

    return dataset.map(pool, of)


def residuals_of(runs: Sequence[MatchedRun]) -> list[np.ndarray]:
    """By run, simulated minus recorded [m, N, N m], shape (channels, samples)."""
    return [each.residual for each in runs]


def unmatched(dataset: RigDataset, runs: Sequence[MatchedRun], model: str) -> list[str]:
    """One sentence for each run whose mean sinkage no zeta was found to match.

    Args:
        dataset: The runs.
        runs: The same, simulated.
        model: Name of the model that simulated them.
    """
    return [
        f"{dataset.runs[run].name}: no zeta was found at which {model} matches its mean sinkage; "
        "its residuals here are at another zeta."
        for run, each in enumerate(runs)
        if not each.matched
    ]


def match_zeta(
    dataset: RigDataset,
    model: AugmentedModel,
    run: int,
    coordinates: np.ndarray,
    start: MatchedRun,
    slope: float | None = None,
    settings: ZetaMatchSettings = DEFAULT_ZETA_MATCH,
) -> MatchedRun:
    """One run simulated at the zeta that matches its mean sinkage.

    Args:
        dataset: The runs.
        model: With effects or without.
        run: Index of the run.
        coordinates: The model's numbers, which stay, shape (numbers,).
        start: The run where the search begins.
        slope: Rise of its mean height there per unit of log zeta [m], above 0, where it is known.
        settings: Numbers of the secant search.
    """
    z, recorded = dataset.channels.index("z"), dataset.recording(run)
    residual = start.residual

    def miss(log_zeta: np.ndarray) -> float:
        nonlocal residual
        residual = dataset.prediction(model, run, float(log_zeta), coordinates) - recorded
        return float(residual[z].mean())

    found = match_mean_sinkage(
        miss,
        start.log_zeta,
        miss_at_start=float(residual[z].mean()),
        slope=slope,
        settings=settings,
    )
    return MatchedRun(residual, float(found.log_zeta), bool(found.matched))
