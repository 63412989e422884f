"""Effects with a strength far from zero, beside a hypothesis.

Where the reference model is far off linear fits about the null say little of an effect such as the
play of a drive, or sand that softens where the wheel slips. Each of a few strengths is simulated.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, best_of_each
from diagnose.hypotheses.refinement import (
    DEFAULT_REFINEMENT,
    RefinementSettings,
    predicted_score,
    refine,
    relinearize,
)
from diagnose.hypotheses.set_candidates import joined_from_null
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata, reported_names, strengths

# Simulations by which an effect is refined from the strength that does best.
SIMULATIONS = 5


def large_strengths(effect: type[AbstractEffect]) -> dict[int, list[float]]:
    """Values far from zero to try [typical sizes], by the strength's place; few have any."""
    about = [field_metadata(effect)[name] for name in strengths(effect)]
    return {
        place: [value / each["typical"] for value in each["far"]]
        for place, each in enumerate(about)
        if each["far"]
    }


def at_large_strengths(
    regressors: Regressors,
    base: Hypothesis,
    pool: RunPool,
    refinement: RefinementSettings = DEFAULT_REFINEMENT,
    max_starts: int = 1,
) -> list[Hypothesis]:
    """A hypothesis with each effect that has large strengths, refined from the best of these.

    Args:
        regressors: The runs.
        base: The hypothesis.
        pool: Threads.
        refinement: Numbers of the refinement.
        max_starts: Strengths and shapes of an effect that are gone on from, at most.

    Returns:
        The best with each effect with which the runs can be simulated.
    """
    tries = [
        (variant, place, value)
        for variant in regressors.variants
        if len(reported_names((*base.names, variant.effect.about.name))) > len(base.names)
        for place, values in large_strengths(variant.effect).items()
        for value in values
    ]

    def simulated(tried: tuple[ShapeVariant, int, float]) -> tuple[float, Hypothesis]:
        here = refine(regressors, _start(regressors, base, *tried), 1, pool, refinement)
        worth = predicted_score(regressors, here, pool) if here.is_simulated else -np.inf
        return worth, here

    def refined(here: Hypothesis) -> Hypothesis:
        # The way there was long: the derivatives that it corrected hold for no small step.
        exact = relinearize(regressors, here, pool)
        return refine(regressors, exact, SIMULATIONS, pool, refinement)

    ranked = sorted(pool.map_outer(simulated, tries), key=lambda each: -each[0])
    count = Counter[tuple[str, ...]]()
    leading = []
    for _, each in ranked:
        if each.is_simulated and count[each.names] < max_starts:
            count[each.names] += 1
            leading.append(each)
    return best_of_each(pool.map_outer(refined, leading))


def _start(
    regressors: Regressors, base: Hypothesis, variant: ShapeVariant, place: int, value: float
) -> Hypothesis:
    """A hypothesis with an effect at its null, and a step to one of its strengths.

    Args:
        regressors: The runs.
        base: The hypothesis.
        variant: The effect.
        place: Place of the strength among the effect's.
        value: The strength [typical sizes].
    """
    step = np.zeros(len(base.coordinates) + len(variant.columns))
    step[len(base.coordinates) + place] = value
    fit = replace(base.fit, coefficients=step, log_zeta_change=np.zeros_like(base.log_zeta))
    return joined_from_null(regressors, base, [variant], fit)
