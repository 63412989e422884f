"""Look-alikes: effects that move the runs nearly as one of a set does, tried in its place.

A set grows by one effect after another. Where two effects look alike, such as a lag of the drive
and a filter of the instruments, the one that leads early may be the wrong one, and what is added
later makes up for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, least_changes
from diagnose.hypotheses.linear_ranking import DEFAULT_RANKINGS, Ranking, fits_beside
from diagnose.hypotheses.set_candidates import (
    SetCandidate,
    exact_beside,
    joined,
    joined_from_null,
    leading_beside,
    taking_turns,
    with_any,
)
from diagnose.hypotheses.set_screening import without_effect
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import catalogue, reported_name, reported_names, strengths


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
        max_deficit_alone: Two effects are exchanged at once where each exchange alone leaves the
            set no further behind in log score [-]. Where two effects make up for two others, either
            of these alone is worse than both and than neither.
        max_doubly_exchanged: Sets with two exchanged, at most.
        min_term_ratio: Ratio of the first shapes of two terms of a sum, at least [-]. Nearer ones
            together make up for a value between two of the grid's, which the refinement of one
            finds.
    """

    max_known_deficit: float = 30.0
    max_deficit: float = 50.0
    min_alike: int = 3
    max_alike: int = 6
    max_continued: int = 2
    rankings: tuple[Ranking, ...] = DEFAULT_RANKINGS[-2:]
    max_deficit_alone: float = 20.0
    max_doubly_exchanged: int = 3
    min_term_ratio: float = 1.28


DEFAULT_EXCHANGE = ExchangeSettings()


def exchanged_sets(
    regressors: Regressors,
    best: Hypothesis,
    known: Sequence[Hypothesis],
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
    with_sums: bool = True,
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
        with_sums: Sums of several terms are tried in an effect's place, too; see `sums_in_place`.

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
    for place, rest, leading in zip(places, rests, by_rest, strict=True):
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
        if with_sums:
            found[-1] += sums_in_place(regressors, best, place, pool, settings)
    return found


def sums_in_place(
    regressors: Regressors,
    best: Hypothesis,
    place: int,
    pool: RunPool,
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[Hypothesis]:
    """A set with a sum of several terms in the place of another form of that effect.

    A bed that nobody levelled has waves of many lengths. One term after the other is taken where a
    linear fit of all terms beside the rest of the set does best, by the responses to one. Where one
    term is in the set, it is the first, with its numbers.

    Args:
        regressors: The runs.
        best: The set.
        place: Of the effect among the set's.
        pool: Threads.
        settings: Numbers of the choice.
    """
    here = best.model.effects[place].about
    found = []
    for kind in catalogue().values():
        about = kind.about
        of_effect = about.sum_of and about.form_of == reported_name(here.name)
        terms = [v for v in regressors.variants if v.effect.about.name == about.sum_of]
        if of_effect and terms and about.name != here.name:
            found.append(_sum_beside(regressors, best, place, kind, terms, pool, settings))
    return found


def _sum_beside(
    regressors: Regressors,
    best: Hypothesis,
    place: int,
    kind: type[AbstractEffect],
    terms: Sequence[ShapeVariant],
    pool: RunPool,
    settings: ExchangeSettings,
) -> Hypothesis:
    """A set with the sum of those of some terms that do best, chosen one after the other.

    Arguments as for `sums_in_place`, with the sum's class, and its terms at all starts.
    """
    rest, has_first = _without(best, place), best.model.effects[place] is terms[0].effect
    base = best if has_first else rest
    own = np.array([f.index == place for f in best.model.free])
    is_shape = np.array([f.scale is None for f in best.model.free])
    chosen, values = list[ShapeVariant](), list[float]()
    if has_first:
        values = [*np.exp(best.coordinates[own & is_shape])]
        chosen = [min(terms, key=lambda each: abs(np.log(each.shapes[0] / values[0])))]
    matrices = regressors.gram_matrices_beside_all(base.columns, base.residual, base.log_zeta, pool)
    to_fit = base.fit.mean_square, settings.rankings[-1:], regressors.settings
    fit, first, count = base.fit, len(chosen), len(base.coordinates)
    apart = settings.min_term_ratio
    while len(chosen) < len(strengths(kind)) // len(strengths(terms[0].effect)):
        # A grid of few values may have none that is so far off.
        others = [t for t in terms if all(_ratio(t, k) > apart for k in chosen)] or list(terms)
        sets = [(*chosen[first:], each) for each in others]
        (fits,) = fits_beside(matrices, least_changes(base), sets, *to_fit)
        leading = max(range(len(fits)), key=lambda k: fits[k].score)
        chosen.append(others[leading])
        values += others[leading].shapes
        fit = fits[leading]
    change, added = fit.coefficients[:count], fit.coefficients[count:]
    if has_first:
        added = np.r_[(best.coordinates + change)[own & ~is_shape], added]
        change = change[~own]
    columns = tuple(column for each in chosen for column in each.columns)
    variant = ShapeVariant(kind, tuple(values), columns, neighbours=())
    whole = replace(fit, coefficients=np.r_[change, added])
    return joined_from_null(regressors, rest, [variant], whole)


def doubly_exchanged(
    best: Hypothesis,
    exchanged: Sequence[Hypothesis],
    settings: ExchangeSettings = DEFAULT_EXCHANGE,
) -> list[Hypothesis]:
    """A set with two of its effects replaced at once, as each was replaced alone.

    What the two exchanges change adds up.

    Args:
        best: The set, simulated.
        exchanged: The same with one effect replaced, simulated.
        settings: Numbers of the choice.

    Returns:
        Sets that are none of the given, with the step to where both exchanges lead.
    """
    least = best.score - settings.max_deficit_alone
    alone = [
        each
        for each in exchanged
        if each.is_simulated
        and each.score > least
        and len(each.names) == len(best.names) == len({*each.names, *best.names}) - 1
    ]
    alone.sort(key=lambda each: -each.score)
    known = {frozenset(each.names) for each in (best, *exchanged)}
    found = []
    for one, other in sorted(
        itertools.combinations(alone, 2), key=lambda pair: -sum(each.score for each in pair)
    ):
        (gone,) = set(best.names).difference(other.names)
        (added,) = set(other.names).difference(best.names)
        names = frozenset(one.names) - {gone} | {added}
        # Of two that replace the same effect, the names are one too many.
        has_room = len(found) < settings.max_doubly_exchanged and len(names) == len(best.names)
        if has_room and len(reported_names(names)) == len(names) and names not in known:
            known.add(names)
            found.append(_with_both(best, one, other, gone, added))
    return found


def _with_both(
    best: Hypothesis, one: Hypothesis, other: Hypothesis, gone: str, added: str
) -> Hypothesis:
    """The set `one` with an effect of the set `other` in the place of another."""
    base = without_effect(one, one.names.index(gone))
    place = other.names.index(added)
    own = [k for k, free in enumerate(other.model.free) if free.index == place]
    columns = [each[:, :, [0, *(1 + k for k in own)]] for each in other.columns]
    before, after = (_by_field(each) for each in (best, other))
    change = [after[key] - before[key] if key in before else 0.0 for key in _by_field(base)]
    return joined(
        base,
        AugmentedModel((other.model.effects[place],)),
        other.coordinates[own],
        columns,
        one.fit,
        (other.log_zeta - best.log_zeta, np.r_[change, np.zeros(len(own))]),
    )


def _by_field(each: Hypothesis) -> dict[tuple[str, str], float]:
    """A hypothesis's coordinates by effect and field."""
    names, found = each.names, dict[tuple[str, str], float]()
    for free, value in zip(each.model.free, each.coordinates, strict=True):
        found[names[free.index], free.field] = float(value)
    return found


def _ratio(first: ShapeVariant, second: ShapeVariant) -> float:
    """Ratio of the larger of two variants' first shapes to the smaller [-]."""
    smaller, larger = sorted((first.shapes[0], second.shapes[0]))
    return larger / smaller


def _without(best: Hypothesis, place: int) -> Hypothesis:
    """A set without one of its effects, and what it misses then, to first order."""
    own = [k for k, f in enumerate(best.model.free) if f.index == place and f.scale is not None]
    residual = [
        left - each[:, :, [1 + k for k in own]] @ best.coordinates[own]
        for left, each in zip(best.residual, best.columns, strict=True)
    ]
    return replace(without_effect(best, place), residual=residual, proposed_step=None)
