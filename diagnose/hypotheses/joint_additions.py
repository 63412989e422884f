"""Two effects that are added to a set at once, by linear fits of all pairs.

Effects that cancel each other are seen neither alone nor one after the other: a carriage's spring
holds the wheel up by what sand that sinks with slip lets it down. A linear fit of both costs next
to nothing, so all pairs of further effects are fitted.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from diagnose.hypotheses.hypothesis import Hypothesis, least_changes, top_ranked
from diagnose.hypotheses.linear_ranking import DEFAULT_RANKINGS, Ranking, best_variants, fits_beside
from diagnose.hypotheses.set_candidates import (
    SetCandidate,
    joined_from_null,
    taking_turns,
)
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool


@dataclass(frozen=True)
class JointSettings:
    """Numbers by which two effects at once are chosen for simulation.

    Attributes:
        max_bases: Refined hypotheses that they are added to, at most.
        min_gain: Log score that both must gain beyond the better one alone [-]. A pair of which one
            does most is found one by one.
        max_per_effect: Pairs with one effect, at most.
        sets: Sets that are simulated.
        max_continued: Of these so many get more than one simulation.
    """

    max_bases: int = 2
    min_gain: float = 8.0
    max_per_effect: int = 2
    sets: int = 4
    max_continued: int = 2


DEFAULT_JOINT = JointSettings()


def joint_starts(
    regressors: Regressors,
    bases: Sequence[Hypothesis],
    known: Sequence[Hypothesis],
    pool: RunPool,
    settings: JointSettings = DEFAULT_JOINT,
) -> list[Hypothesis]:
    """Sets of two effects more than the bases have, with the step that a linear fit proposes.

    Args:
        regressors: The runs.
        bases: Hypotheses of one size, best first.
        known: Sets of two effects more that were simulated already.
        pool: Threads.
        settings: Numbers of the choice.
    """
    taken, found = {frozenset(each.names) for each in known}, list[SetCandidate]()
    count = Counter[str]()
    firsts = top_ranked(bases, settings.max_bases)
    for each in joint_candidates(regressors, firsts, settings.min_gain, pool):
        added = each.names.difference(each.base.names)
        too_often = any(count[name] >= settings.max_per_effect for name in added)
        if each.has_two_forms or too_often or each.names in taken:
            continue
        taken.add(each.names)
        count.update(added)
        found.append(each)
        if len(found) == settings.sets:
            break
    return [each.build() for each in found]


def joint_candidates(
    regressors: Regressors,
    bases: Sequence[Hypothesis],
    min_gain: float,
    pool: RunPool,
    rankings: Sequence[Ranking] = DEFAULT_RANKINGS,
) -> Iterator[SetCandidate]:
    """Sets of two effects more than the bases have, the rankings taking turns.

    Args:
        regressors: The runs.
        bases: Hypotheses that effects are added to, best first, of one size.
        min_gain: Log score that both effects must gain beyond the better one alone [-].
        pool: Threads.
        rankings: Numbers of the linear fits.

    Returns:
        One may come more than once.
    """
    by_base = pool.map_outer(
        lambda each: _by_ranking(regressors, each, min_gain, pool, rankings), bases
    )
    orders = []
    for of_each in zip(*by_base, strict=True):
        together = itertools.chain.from_iterable(of_each)
        orders.append(sorted(together, key=lambda each: -each.score))
    return taking_turns(orders)


def _by_ranking(
    regressors: Regressors,
    first: Hypothesis,
    min_gain: float,
    pool: RunPool,
    rankings: Sequence[Ranking],
) -> list[list[SetCandidate]]:
    """A base with two further effects from their null, by each of the rankings."""
    of_run = first.columns, first.residual, first.log_zeta
    matrices = regressors.gram_matrices_beside_all(*of_run, pool)
    miss, weights, lower = first.fit.mean_square, regressors.settings, least_changes(first)
    others = [v for v in regressors.variants if v.effect.about.name not in first.names]
    by_ranking = best_variants(matrices, lower, others, miss, rankings, weights)
    found = []
    for ranking, leading in zip(rankings, by_ranking, strict=True):
        alone = {name: fit.score for name, (_, fit) in leading.items()}
        pairs = list(itertools.combinations(leading, 2))
        sets = [[leading[name][0] for name in pair] for pair in pairs]
        (fits,) = fits_beside(matrices, lower, sets, miss, [ranking], weights)
        order = []
        for pair, both, fit in zip(pairs, sets, fits, strict=True):
            if fit.score < max(alone[name] for name in pair) + min_gain:
                continue
            build = partial(joined_from_null, regressors, first, both, fit)
            names = frozenset((*first.names, *pair))
            order.append(SetCandidate(names, True, fit.score, first, build))
        found.append(order)
    return found
