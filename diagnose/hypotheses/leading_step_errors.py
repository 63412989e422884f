"""Error of the simulation's step at the numbers of the leading hypothesis.

A search begins with the error that steps have with the reference model taken off, as it is cheap.
Effects change this error by a few per cent of what they change the runs by. So where a hypothesis
leads, the error is found anew at its numbers: values of all that are like it are those of far
shorter steps.

A wheel that just stands, or drops by a millimetre in the first tenth of a second, may do one in
long steps and the other in short ones. That is no error that other hypotheses share. A run which
the leading one would follow far worse keeps the error that is known.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnose.dataset import step_errors, with_step_errors
from diagnose.hypotheses.hypothesis import Hypothesis, best_first
from diagnose.hypotheses.refinement import simulated_fit
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool

# A run is followed far worse where the RMS of a channel's residual grows by this share [-] and by
# so many model errors more. The error of a wheel that starts late by a drive's play is another by
# 54 um of x, under three; a wheel that drops changes z by eleven and more (20 um each).
MAX_GROWTH, MAX_MODEL_ERRORS = 0.5, 5.0


def without_leading_step_errors(
    regressors: Regressors, by_size: Sequence[Sequence[Hypothesis]], pool: RunPool
) -> tuple[Regressors, list[list[Hypothesis]]]:
    """The runs and hypotheses without the error of the step at the leading one's numbers.

    Args:
        regressors: The runs.
        by_size: Hypotheses of one effect, of two, and so on, best first within one size.
        pool: Threads.

    Returns:
        The runs, whose simulations from now on are without it, and hypotheses of each size, best
        first: those that were simulated have other residuals. As given where none was simulated.
    """
    leading = [several[0] for several in by_size if several and several[0].is_simulated]
    if not leading:
        return regressors, [list(several) for several in by_size]
    best = max(leading, key=lambda each: each.score)
    known = regressors.dataset
    errors = step_errors(known, best.model, best.log_zeta, best.coordinates, pool)
    changes = []
    for run, error in enumerate(errors):
        before = np.asarray(known.observations[run].step_error)[:, : error.shape[1]]
        change = known.holds[run].of_simulation((before - error)[:, known.counts(run)])
        if _is_far_worse(regressors, best.residual[run], change):
            errors[run], change = before, np.zeros_like(change)
        changes.append(change)
    dataset = with_step_errors(known, errors)

    def moved(residual: Sequence[np.ndarray]) -> list[np.ndarray]:
        return [left + change for left, change in zip(residual, changes, strict=True)]

    there = replace(regressors, dataset=dataset, residual=moved(regressors.residual))

    def changed(each: Hypothesis) -> Hypothesis:
        if not each.is_simulated:
            return each
        residual = moved(each.residual)
        at = each.log_zeta, each.coordinates, residual
        return replace(each, residual=residual, fit=simulated_fit(there, each, *at, pool))

    changed_sizes = [pool.map_outer(changed, several) for several in by_size]
    return there, [best_first(several) for several in changed_sizes]


def _is_far_worse(regressors: Regressors, residual: np.ndarray, change: np.ndarray) -> bool:
    """Tell whether a change of a run's residual is more than a step's error may be.

    Args:
        regressors: The runs.
        residual: Of the leading hypothesis in one run [m, N, N m], shape (channels, samples).
        change: Of this residual, likewise.
    """
    blocks = [(channel, "slow") for channel in regressors.dataset.channels]
    before, after = (np.sqrt((each**2).mean(axis=1)) for each in (residual, residual + change))
    most = (1 + MAX_GROWTH) * before
    most += MAX_MODEL_ERRORS * regressors.settings.model_errors(blocks)
    return bool((after > most).any())
