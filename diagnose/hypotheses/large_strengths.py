"""Effects with a strength far from zero, beside a hypothesis.

Where the reference model is far off linear fits about the null say little of an effect such as the
play of a drive, or sand that softens where the wheel slips. Each of a few strengths is simulated.
"""

from collections import Counter
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class LargeStrengthSettings:
    """Numbers by which strengths far from zero are gone on from.

    Attributes:
        max_starts: Strengths and shapes of an effect alone, at most.
        max_starts_beside: The same beside other effects, whose numbers are known by then.
        simulations: Simulations from each, at most.
    """

    max_starts: int = 4
    max_starts_beside: int = 1
    simulations: int = 5


DEFAULT_LARGE_STRENGTHS = LargeStrengthSettings()


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
    settings: LargeStrengthSettings = DEFAULT_LARGE_STRENGTHS,
    refinement: RefinementSettings = DEFAULT_REFINEMENT,
) -> list[Hypothesis]:
    """A hypothesis with each effect that has large strengths, refined from the best of these.

    Args:
        regressors: The runs.
        base: The hypothesis.
        pool: Threads.
        settings: Numbers of the choice.
        refinement: Numbers of the refinement.

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
        return refine(regressors, exact, settings.simulations, pool, refinement)

    ranked = sorted(pool.map_outer(simulated, tries), key=lambda each: -each[0])
    most = settings.max_starts_beside if base.names else settings.max_starts
    count = Counter[tuple[str, ...]]()
    leading = []
    for _, each in ranked:
        if each.is_simulated and count[each.names] < most:
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
