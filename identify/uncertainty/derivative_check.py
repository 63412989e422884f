"""Derivatives of a fit beside one finite difference along the way that the fit went.

Where a plate turns over at every step, as on far too stiff sand, the derivative of a run is no
slope over any change that matters, to neither side. One more simulation shows it, or two.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drftjax.recorded.prepared_run import PreparedRun
from identify.solver.levenberg_marquardt import Solution
from identify.solver.problem import Coordinates, Problem


@dataclass(frozen=True)
class DerivativeCheckSettings:
    """Numbers of the check.

    Attributes:
        change: Largest change of a coordinate [-]; of a positive number its logarithm: half a per
            cent, as wide as a secant over corners that a run passes must be.
        doubtful: Relative difference of a run's change from the predicted one that is reported:
            twice what corners leave in a derivative that is right.
        least: Difference per sample below which none is reported, in the RMS of the channel's
            residuals [-]: where a run hardly changes, only corners do.
    """

    change: float = 5e-3
    doubtful: float = 0.1
    least: float = 0.1


DERIVATIVE_CHECK_SETTINGS = DerivativeCheckSettings()


def derivative_doubts(
    problem: Problem,
    solution: Solution,
    start: Coordinates,
    runs: Sequence[PreparedRun],
    settings: DerivativeCheckSettings = DERIVATIVE_CHECK_SETTINGS,
) -> list[str]:
    """Sentences on runs whose derivatives a finite difference contradicts.

    Args:
        problem: Of the fit.
        solution: Its end.
        start: Coordinates from which the fit came.
        runs: Runs of the fit.
        settings: Numbers of the check.
    """
    errors = derivative_errors(problem, solution, start, settings)
    return [
        f"{run.name}: over a small step its simulation changes otherwise than its derivatives say,"
        f" by {100 * error:.2g} %, so its errors, and whether it converged, are doubtful"
        for run, error in zip(runs, errors, strict=False)
        if error > settings.doubtful
    ]


def derivative_errors(
    problem: Problem,
    solution: Solution,
    start: Coordinates,
    settings: DerivativeCheckSettings = DERIVATIVE_CHECK_SETTINGS,
) -> np.ndarray:
    """Relative difference of each run's change from the one predicted, shape (runs,).

    Zero for a run that is put aside, that no coordinate moved, or whose difference is negligible.
    """
    ways = [np.asarray(end - begin) for end, begin in zip(solution.coordinates, start, strict=True)]
    # A run that is put aside ends anywhere.
    ways[1] = np.where(solution.active[:, None], ways[1], 0)
    longest = max((float(np.abs(way).max(initial=0)) for way in ways), default=0.0)
    if not longest > 0:
        return np.zeros(len(solution.active))
    counted = (np.asarray(problem.batch.observed.weight) > 0).sum(axis=(1, 2))

    def errors(sense: int) -> np.ndarray:
        shared, own = (sense * settings.change / longest * way for way in ways)
        moved = solution.coordinates[0] + shared, solution.coordinates[1] + own
        residual = problem.residual(*problem.on_all_devices(moved))
        change = np.asarray(residual) - solution.residual
        found = []
        for run, active in enumerate(solution.active):
            predicted = solution.blocks[run] @ np.concatenate([shared, own[run]])
            size = float(np.linalg.norm(predicted))
            off = float(np.linalg.norm(change[run] - predicted))
            told = active and size > 0 and off > settings.least * np.sqrt(counted[run])
            found.append(off / size if told else 0.0)
        return np.array(found)

    onward = errors(1)
    if not (onward > settings.doubtful).any():
        return onward
    # A wheel that just stands on its sand has a slope to either side: sand that is weaker lets it
    # sink, stronger sand leaves it. Its derivative is right where it is that of one of them.
    return np.minimum(onward, errors(-1))
