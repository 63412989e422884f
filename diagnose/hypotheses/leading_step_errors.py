"""Error of the simulation's step at the numbers of the leading hypothesis.

A search begins with the error that steps have with the reference model taken off, as it is cheap.
Effects change this error by a few per cent of what they change the runs by. So where a hypothesis
leads, the error is found anew at its numbers: values of all that are like it are those of far
shorter steps.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnose.dataset import step_errors, with_step_errors
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.refinement import simulated_fit
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool


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
    dataset = with_step_errors(known, errors)
    changes = []
    for run in known.run_numbers:
        counts = known.counts(run)
        before, after = (each.observations[run].step_error for each in (known, dataset))
        changes.append(np.asarray(before - after)[:, : len(counts)][:, counts])

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
    return there, [sorted(several, key=lambda each: -each.score) for several in changed_sizes]
