"""The verdict: what the weights of all explanations come to, and what cannot be told from it."""

from collections.abc import Mapping, Sequence

from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.selection.model_weights import NONE, UNKNOWN
from drftjax.effects.catalogue import reported_names

# Effects are named together until this much of the weight is named.
GROUPED = 0.9


# An effect of less weight than this is not named at all.
NAMED = 0.1


# Effects are named at all where together they outweigh `none` by this. It holds down the rate of
# false alarms, and is no part of the weights, which say what is likely: many rigs have an effect so
# faint that these runs could as well have none.
ALARM = 4.5


# An explanation that has less weight than this needs no run that tells it from the verdict.
RIVAL = 0.02


# And one run is asked to tell it from so many at most.
MOST_RIVALS = 3


def decide(
    share: Mapping[tuple[str, ...], float],
) -> tuple[tuple[str, ...], list[list[str]]]:
    """The explanation that stands, and the groups that cannot be told apart from it.

    Effects that share their weight speak together: all of them against none and unknown, then all
    pairs against all effects alone. A second effect that has many likenesses is no less there.
    `none` stands until effects or unknown outweigh it `ALARM` times.
    """
    ranked = sorted(share.items(), key=lambda each: -each[1])
    effects = [each for each in ranked if each[0] not in ((NONE,), (UNKNOWN,))]
    none, unknown = ALARM * share.get((NONE,), 0.0), share.get((UNKNOWN,), 0.0)
    if effects and _total(effects) >= max(none, unknown):
        alone = [each for each in effects if len(each[0]) == 1]
        pairs = [each for each in effects if len(each[0]) == 2]
        ranked = max(alone, pairs, key=_total)
    else:
        stands = (NONE,) if none >= unknown else (UNKNOWN,)
        ranked.sort(key=lambda each: each[0] != stands)
    verdict, whole = ranked[0][0], _total(ranked)
    kept, total = [], 0.0
    for names, weight in ranked:
        if kept and (total >= GROUPED * whole or weight < NAMED):
            break
        kept.append(names)
        total += weight
    groups: list[list[str]] = []
    for first in verdict:
        group = [first]
        for names in kept[1:]:
            others = [n for n in names if n not in verdict]
            if len(names) == len(verdict):
                same = set(names) & set(verdict)
                if len(verdict) == 1 or (len(same) == 1 and first not in same):
                    group += [n for n in others if n not in group]
        groups.append(group)
    return verdict, groups


def reassign_unknown(
    share: Mapping[tuple[str, ...], float], name: str
) -> dict[tuple[str, ...], float]:
    """The weights where what was unknown is an effect of the list in a form that nobody wrote.

    Args:
        share: By the names of the effects; of `unknown` too.
        name: The effect.
    """
    moved = share.get((name,), 0.0) + share[(UNKNOWN,)]
    return {**share, (name,): moved, (UNKNOWN,): 0.0}


def weight_by_name(share: Mapping[tuple[str, ...], float]) -> dict[str, float]:
    """Weight of each name: that of every hypothesis it is part of."""
    total: dict[str, float] = {}
    for names, weight in share.items():
        for name in reported_names(names):
            total[name] = total.get(name, 0.0) + weight
    return dict(sorted(total.items(), key=lambda each: -each[1]))


def hypothesis_behind(
    found: ScreeningResult,
    leading: Sequence[Hypothesis],
    share: Mapping[tuple[str, ...], float],
    verdict: tuple[str, ...],
) -> Hypothesis:
    """The hypothesis that the verdict stands for; for unknown, the likeliest written one."""
    if verdict == (NONE,):
        return found.none
    if verdict == (UNKNOWN,):
        return max(leading, key=lambda each: share[each.names], default=found.none)
    return next(each for each in leading if each.names == verdict)


def competing_hypotheses(
    found: ScreeningResult,
    leading: Sequence[Hypothesis],
    share: Mapping[tuple[str, ...], float],
    verdict: tuple[str, ...],
) -> list[Hypothesis]:
    """The other explanations that a run should tell from the verdict, the likeliest first.

    The likeliest is one where it is likely enough to matter, more where they are named beside it.
    """
    if verdict == (UNKNOWN,):
        return []
    others = {each.names or (NONE,): each for each in (found.none, *leading)}
    # Two forms of one effect need no telling apart.
    told, rivals = {frozenset(reported_names(verdict))}, []
    for names in sorted(others, key=lambda names: -share[names]):
        if share[names] < (NAMED if rivals else RIVAL) or len(rivals) == MOST_RIVALS:
            break
        if frozenset(reported_names(names)) not in told:
            told.add(frozenset(reported_names(names)))
            rivals.append(others[names])
    return rivals


def _total(ranked: Sequence[tuple[tuple[str, ...], float]]) -> float:
    return sum(weight for _, weight in ranked)
