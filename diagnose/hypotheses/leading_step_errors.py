"""Error of the simulation's step at the numbers of the leading hypothesis.

The search takes off the error that steps have with the reference model, as it is cheap. Effects
change this error by a few per cent of what they change the runs by. So once a hypothesis leads, the
error is found anew at its numbers: values of all that are like it are those of far shorter steps.
The reference model keeps the error that was found with it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnose.dataset import RigDataset, step_errors, with_step_errors
from diagnose.hypotheses.hypothesis import Hypothesis, top_ranked
from diagnose.hypotheses.refinement import RefinementSettings, refine, simulated_fit
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool


def without_leading_step_errors(
    found: ScreeningResult,
    dataset: RigDataset,
    counts: Sequence[int],
    pool: RunPool,
    settings: RefinementSettings,
) -> tuple[ScreeningResult, RigDataset]:
    """The screening and its runs without the error of the step at the leading numbers.

    Args:
        found: The screening.
        dataset: The runs, with all plates.
        counts: Of each size, how many explanations are simulated once more, as they are weighed.
        pool: Threads.
        settings: Numbers of the refinement.

    Returns:
        As given where no effect was simulated.
    """
    leading = [several[0] for several in found.by_size if several and several[0].is_simulated]
    if not leading:
        return found, dataset
    best = max(leading, key=lambda each: each.score)
    known = found.regressors.dataset
    errors = step_errors(known, best.model, best.log_zeta, best.coordinates, pool)
    regressors = replace(found.regressors, dataset=with_step_errors(known, errors))
    changes = [
        (before.step_error - after.step_error)[:, : len(known.counts(run))][:, known.counts(run)]
        for run, (before, after) in enumerate(
            zip(known.observations, regressors.dataset.observations, strict=True)
        )
    ]

    def changed(each: Hypothesis) -> Hypothesis:
        if not each.is_simulated:
            return each
        residual = [np.asarray(r + c) for r, c in zip(each.residual, changes, strict=True)]
        at = each.log_zeta, each.coordinates, residual
        return replace(each, residual=residual, fit=simulated_fit(regressors, each, *at, pool))

    def refined(several: Sequence[Hypothesis], count: int) -> tuple[Hypothesis, ...]:
        again = {id(each) for each in top_ranked(several, count) if each.is_simulated}
        every = pool.map_outer(
            lambda each: _refined(regressors, changed(each), id(each) in again, pool, settings),
            several,
        )
        return tuple(sorted(every, key=lambda each: -each.score))

    by_size = [refined(*each) for each in zip(found.by_size, counts, strict=True)]
    moved = replace(
        found,
        regressors=regressors,
        singles=by_size[0],
        pairs=by_size[1],
        larger_sets=tuple(by_size[2:]),
    )
    return moved, with_step_errors(dataset, errors)


def _refined(
    regressors: Regressors,
    each: Hypothesis,
    again: bool,
    pool: RunPool,
    settings: RefinementSettings,
) -> Hypothesis:
    return refine(regressors, each, 1, pool, settings) if again else each
