"""What a diagnosis promised, measured on runs that it never saw."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagnose.added import as_model
from diagnose.case import Case
from diagnose.diagnosis import Diagnosis
from diagnose.response import Model
from diagnose.runs import from_one_start
from diagnose.shrinkage import Gap, gaps
from identify.candidate import candidates_of

# A run's own zeta is found by so many secant steps on its mean sinkage.
MOST_TURNS = 8
CLOSE_ENOUGH = 1e-4
# A mean sinkage is met within this [m], half the noise of a good scale, or where steps end.
MET = 1e-5


def measured_on(diagnosis: Diagnosis, paths: Sequence[Path]) -> dict[str, Gap]:
    """The gap before and after on other runs of the same rig, by channel.

    Args:
        diagnosis: Whose effects or correction are added, with their numbers as they are.
        paths: The other runs.
    """
    case = Case.of(from_one_start(candidates_of(list(paths)), diagnosis.origin))
    before = followed(case, Model(), np.zeros(0))
    after = followed(case, *as_model(diagnosis.added.effects))
    return gaps(
        case,
        [each.residual for each in before],
        [each.residual for each in after],
        diagnosis.floors,
    )


@dataclass(frozen=True, eq=False)
class Followed:
    """A run simulated with its own zeta.

    Attributes:
        residual: Simulated less recorded, shape (channels, samples).
        log_zeta: Logarithm of its zeta over its set-up's.
        met: Whether that zeta meets the run's mean sinkage.
    """

    residual: np.ndarray
    log_zeta: float
    met: bool


def followed(case: Case, model: Model, coordinates: np.ndarray) -> list[Followed]:
    """Every run simulated with a model's effects, zeta fitted to each.

    Args:
        case: Runs that the effects were not found on.
        model: The effects.
        coordinates: Their numbers, which stay.
    """
    at = np.asarray(coordinates)
    return case.each_run(lambda run: _with_own_zeta(case, model, run, at))


def _with_own_zeta(case: Case, model: Model, run: int, coordinates: np.ndarray) -> Followed:
    """A run at the zeta that meets its mean sinkage."""
    recorded = case.recorded(run)
    z = case.channels.index("z")

    def of(log_zeta: float) -> np.ndarray:
        return case.predicted(model, run, log_zeta, coordinates) - recorded

    at, here = 0.0, of(0.0)
    move = float(np.clip(-here[z].mean() / 0.02, -0.2, 0.2))
    for _ in range(MOST_TURNS):
        there = of(at + move)
        slope = (there[z].mean() - here[z].mean()) / move if move else 0.0
        at, here = at + move, there
        if not np.isfinite(slope) or slope <= 0:
            break
        move = float(np.clip(-here[z].mean() / slope, -0.2, 0.2))
        if abs(move) < CLOSE_ENOUGH:
            break
    close = abs(here[z].mean()) < MET or abs(move) < CLOSE_ENOUGH
    return Followed(here, at, met=bool(close))
