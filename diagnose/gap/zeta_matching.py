"""Runs at the zeta that meets each one's mean sinkage: a rule that needs no weights.

The zeta that suits all channels best may give one up for another, and which is a matter of weights.
This one is what sinkage alone tells, as on runs that no effect was fitted to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnose.dataset import MAX_LOG_ZETA_STEP, SINKAGE_PER_LOG_ZETA, RigDataset
from diagnose.model.augmented_model import AugmentedModel

# It is found by so many secant steps.
MOST_TURNS = 8


CLOSE_ENOUGH = 2e-5


# A mean sinkage is met within this [m], half the noise of a good scale, or where steps end.
MET = 1e-5


# What reports call the two models.
REFERENCE, WITH = "the reference model", "the model with the effects"


@dataclass(frozen=True, eq=False)
class MatchedRun:
    """A run simulated with its own zeta.

    Attributes:
        residual: Simulated less recorded, shape (channels, samples).
        log_zeta: Logarithm of its zeta over its set-up's.
        met: Whether that zeta meets the run's mean sinkage.
    """

    residual: np.ndarray
    log_zeta: float
    matched: bool


def match_runs(
    case: RigDataset, model: AugmentedModel, coordinates: np.ndarray
) -> list[MatchedRun]:
    """Every run simulated with a model's effects, zeta fitted to each.

    Args:
        case: Runs that the effects were not found on.
        model: The effects.
        coordinates: Their numbers, which stay.
    """
    at = np.asarray(coordinates)

    def of(run: int) -> MatchedRun:
        first = case.prediction(model, run, 0.0, at) - case.recording(run)
        return match_zeta(case, model, run, at, MatchedRun(first, 0.0, matched=False))

    return case.map_runs(of)


def residuals_of(runs: Sequence[MatchedRun]) -> list[np.ndarray]:
    """By run, simulated less recorded, shape (channels, samples) [m, N, N m]."""
    return [each.residual for each in runs]


def unmatched(case: RigDataset, runs: Sequence[MatchedRun], model: str) -> list[str]:
    """The runs whose mean sinkage no zeta was found to meet, in sentences."""
    return [
        f"{case.runs[run].name}: no zeta was found at which {model} meets its mean sinkage; "
        "what is told of it is at another zeta."
        for run, each in enumerate(runs)
        if not each.matched
    ]


def match_zeta(
    case: RigDataset,
    model: AugmentedModel,
    run: int,
    coordinates: np.ndarray,
    start: MatchedRun,
    slope: float = SINKAGE_PER_LOG_ZETA,
) -> MatchedRun:
    """A run at the zeta that meets its mean sinkage.

    Args:
        case: The runs.
        model: With effects or without.
        run: Its number.
        coordinates: The model's numbers, which stay.
        start: The run where secant steps begin.
        slope: About what its mean sinkage rises by there per unit of log zeta [m], above 0.
    """
    z = case.channels.index("z")

    def step(miss: float, slope: float) -> float:
        return float(np.clip(-miss / slope, -MAX_LOG_ZETA_STEP, MAX_LOG_ZETA_STEP))

    at, here = start.log_zeta, start.residual
    move = step(here[z].mean(), slope)
    for _ in range(MOST_TURNS):
        there = case.prediction(model, run, at + move, coordinates) - case.recording(run)
        slope = (there[z].mean() - here[z].mean()) / move if move else 0.0
        at, here = at + move, there
        if not np.isfinite(slope) or slope <= 0:
            break
        move = step(here[z].mean(), slope)
        if abs(move) < CLOSE_ENOUGH:
            break
    close = abs(here[z].mean()) < MET or abs(move) < CLOSE_ENOUGH
    return MatchedRun(here, at, matched=bool(close))
