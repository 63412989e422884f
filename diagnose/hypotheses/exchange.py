"""Look-alikes: effects that move the runs nearly as one of a set does, tried in its place.

A set grows by one effect after another. Where two effects look alike, such as a lag of the drive
and a filter of the instruments, the one that leads early may be the wrong one, and what is added
later makes up for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.linear_ranking import DEFAULT_RANKINGS, Ranking
from diagnose.hypotheses.set_candidates import (
    SetCandidate,
    exact_beside,
    leading_beside,
    taking_turns,
    with_any,
)
from diagnose.hypotheses.set_screening import without_effect
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class ExchangeSettings:
    """Numbers by which effects of a set are exchanged.

    Attributes:
        max_known_deficit: Sets that were simulated already are not begun again where they are no
            further behind the set in log score [-]; others may do better from another start.
        max_deficit: Beyond `min_alike` none is tried that a linear fit puts further behind it [-].
        min_alike: Effects tried in the place of one in any case: where the other did much, a linear
            fit puts one that does as well far behind, and even behind others.
        max_alike: The same at most.
        max_continued: Of these so many get more than one simulation. Where others made up for a
            wrong effect, one simulation does not tell the right one yet.
        rankings: Linear fits rank what may take an effect's place once by each of these.
    """

    max_known_deficit: float = 30.0
    max_deficit: float = 50.0
    min_alike: int = 3
    max_alike: int = 6
    max_continued: int = 2
    rankings: tuple[Ranking, ...] = DEFAULT_RANKINGS[-2:]


DEFAULT_EXCHANGE = ExchangeSettings()


def exchanged_sets(
    regressors: Regressors,
    best: Hypothesis,
    known: Sequence[Hypothesis],
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[list[Hypothesis]]:
    """A set with one effect after the other replaced by others, each with a step proposed.

    Linear fits rank what does most in the effect's place, beside the rest of the set and zeta, with
    derivatives by the simulator at the set's numbers.

    Args:
        regressors: The runs.
        best: The set, simulated.
        known: Sets that were simulated already.
        pool: Threads.
        settings: Numbers of the choice.

    Returns:
        By effect that is replaced.
    """
    least = best.score - settings.max_known_deficit
    tried = {frozenset(each.names) for each in known if each.score > least}
    tried.add(frozenset(best.names))
    places = range(len(best.model.effects))
    rests = [_without(best, place) for place in places]
    by_rest = pool.map_outer(
        lambda rest: leading_beside(
            regressors, rest, best.fit.mean_square, pool, settings.rankings
        ),
        rests,
    )
    given = exact_beside(regressors, best, by_rest, pool)
    found = []
    for rest, leading in zip(rests, by_rest, strict=True):
        orders = with_any(
            regressors, rest, leading, best.fit.mean_square, pool, settings.rankings, given
        )
        # Of an effect of several forms the one that a linear fit ranks first: others would take
        # the places of further effects.
        starts: dict[frozenset[str], SetCandidate] = {}
        for each in taking_turns([sorted(order, key=lambda e: -e.score) for order in orders]):
            is_near = each.score > best.score - settings.max_deficit
            is_new = each.names not in tried and not each.has_two_forms
            if is_new and (is_near or len(starts) < settings.min_alike):
                starts.setdefault(frozenset(reported_names(each.names)), each)
        found.append([each.build() for each in [*starts.values()][: settings.max_alike]])
    return found


def _without(best: Hypothesis, place: int) -> Hypothesis:
    """A set without one of its effects, and what it misses then, to first order."""
    own = [k for k, f in enumerate(best.model.free) if f.index == place and f.scale is not None]
    residual = [
        left - each[:, :, [1 + k for k in own]] @ best.coordinates[own]
        for left, each in zip(best.residual, best.columns, strict=True)
    ]
    return replace(without_effect(best, place), residual=residual, proposed_step=None)
