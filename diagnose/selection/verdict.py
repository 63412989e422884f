"""The verdict: the set of effects with the most weight, and those that cannot be told from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.hypotheses.screening import ScreeningResult
from diagnose.selection.model_weights import NONE, UNKNOWN
from drftjax.effects.catalogue import reported_names

# Weight of each explanation, by the names of its effects; ("none",) and ("unknown",) too. A set
# beside which something unknown acts ends in "unknown".
Weights = Mapping[tuple[str, ...], float]


Named = TypeVar("Named")


@dataclass(frozen=True)
class VerdictSettings:
    """Numbers by which weights become a verdict.

    Attributes:
        group_weight: Effects are named together until this share of the weight is named [-].
        min_named_weight: An effect of less weight than this is not named beside another [-].
        alarm_ratio: Effects or `unknown` are named at all where they outweigh `none` by this factor
            [-]. It holds down the rate of false alarms, and is no part of the weights, which say
            what is likely: many rigs have an effect so faint that these runs could as well have
            none.
        min_competing_weight: An explanation that has less weight than this needs no run that tells
            it from the verdict [-].
        min_explaining_weight: A larger set is asked whether it leaves no gap, where the likeliest
            leaves one, if it has at least this share of the likeliest's weight [-].
        listed_share: Share of the weight of `unknown` that goes to effects which explain most of a
            large gap [-]: about as often such an effect is right.
        part_listed_share: The same where they explain a part of it [-]: more than even odds, and
            less than where they explain most. It is chosen, not counted.
        max_retries: Sets of effects that are dropped at most because they make a channel worse.
        max_competing: One run is asked to tell the verdict from so many at most.
    """

    group_weight: float = 0.95
    min_named_weight: float = 0.05
    alarm_ratio: float = 4.5
    min_competing_weight: float = 0.02
    min_explaining_weight: float = 0.01
    listed_share: float = 0.7
    part_listed_share: float = 0.6
    max_retries: int = 3
    max_competing: int = 3


DEFAULT_VERDICT = VerdictSettings()


def decide(
    share: Weights, settings: VerdictSettings = DEFAULT_VERDICT, has_gap: bool = True
) -> tuple[tuple[str, ...], list[list[str]]]:
    """The verdict, and the groups of names that cannot be told from each of its effects.

    Effects that share their weight speak together: all of them against none and unknown, then all
    sets of one size against all of another. A second effect that has many likenesses is no less
    there. `none` stands until effects or unknown outweigh it by `settings.alarm_ratio`. Beside
    effects `unknown` is a remainder, and no part of the verdict.

    Args:
        share: Weights that sum to one.
        settings: Numbers of the verdict.
        has_gap: Some channel has a gap; else it is `none`, whatever the weights.

    Returns:
        Names of the verdict, and for each of them a group that begins with it.
    """
    ranked = _speaking_together(share, settings) if has_gap else _with_first(share, NONE)
    verdict, whole = ranked[0][0], _total(ranked)
    kept = named_together(ranked, settings.group_weight * whole, settings.min_named_weight)
    return verdict, [_group(first, verdict, kept[1:]) for first in verdict]


def named_together(
    ranked: Sequence[tuple[Named, float]], enough: float, least: float
) -> list[Named]:
    """The first explanation, and those after it until enough of the weight is named.

    Args:
        ranked: Explanations with their weights, heaviest first.
        enough: Weight after which no further one is named [-].
        least: One of less weight than this is not named beside another [-].
    """
    kept: list[Named] = []
    total = 0.0
    for names, weight in ranked:
        if kept and (total >= enough or weight < least):
            break
        kept.append(names)
        total += weight
    return kept


def weight_by_set(share: Weights) -> dict[tuple[str, ...], float]:
    """Weight of each set of effects, with and without a remainder, heaviest first."""
    total: dict[tuple[str, ...], float] = {}
    for names, weight in share.items():
        listed = tuple(name for name in names if name != UNKNOWN) or names
        total[listed] = total.get(listed, 0.0) + weight
    return dict(sorted(total.items(), key=lambda each: -each[1]))


def _speaking_together(
    share: Weights, settings: VerdictSettings
) -> list[tuple[tuple[str, ...], float]]:
    """The explanations of the kind that the verdict is of, heaviest first.

    Where effects stand, only those of the winning number of effects; else all, with none or unknown
    in front.
    """
    ranked = list(weight_by_set(share).items())
    effects = [each for each in ranked if each[0] not in ((NONE,), (UNKNOWN,))]
    none = settings.alarm_ratio * share.get((NONE,), 0.0)
    unknown = share.get((UNKNOWN,), 0.0)
    if effects and _total(effects) >= max(none, unknown):
        sizes = {len(names) for names, _ in effects}
        by_size = [[each for each in effects if len(each[0]) == size] for size in sizes]
        return max(by_size, key=_total)
    return _with_first(share, NONE if none >= unknown else UNKNOWN)


def _with_first(share: Weights, stands: str) -> list[tuple[tuple[str, ...], float]]:
    """All explanations, heaviest first, but none or unknown in front."""
    ranked = list(weight_by_set(share).items())
    return sorted(ranked, key=lambda each: each[0] != (stands,))


def _group(first: str, verdict: tuple[str, ...], others: Sequence[tuple[str, ...]]) -> list[str]:
    """Names that may stand in the place of one name of the verdict, that one first."""
    group = [first]
    for names in others:
        if len(names) != len(verdict):
            continue
        same = set(names) & set(verdict)
        if len(same) == len(verdict) - 1 and first not in same:
            group += [n for n in names if n not in verdict and n not in group]
    return group


def reassign_unknown(share: Weights, name: str) -> dict[tuple[str, ...], float]:
    """Weights after that of `unknown` went to an effect of the catalogue.

    Where the runs show it in a form that the catalogue lacks: what is unknown, and what the list's
    form leaves, is then that effect.

    Args:
        share: Weights with `unknown`.
        name: The effect.
    """
    unknown = {names: share[names] for names in ((UNKNOWN,), (name, UNKNOWN)) if names in share}
    moved = share.get((name,), 0.0) + sum(unknown.values())
    return {**share, **dict.fromkeys(unknown, 0.0), (name,): moved}


def explaining_candidates(
    share: Weights, likeliest: tuple[str, ...], settings: VerdictSettings = DEFAULT_VERDICT
) -> list[tuple[str, ...]]:
    """The likeliest set, and the likeliest of each larger size that is not far less likely.

    Args:
        share: Weights with `unknown`.
        likeliest: Names of the likeliest set.
        settings: Numbers of the verdict.

    Returns:
        Names of the likeliest set, then of one set of each larger size, the smallest first.
    """
    by_set = weight_by_set(share)
    least = settings.min_explaining_weight * by_set.get(likeliest, 0.0)
    larger: dict[int, tuple[str, ...]] = {}
    for names, weight in by_set.items():
        if len(names) > len(likeliest) and weight >= least and names not in ((NONE,), (UNKNOWN,)):
            larger.setdefault(len(names), names)
    return [likeliest, *(larger[size] for size in sorted(larger))]


def believing_listed(
    share: Weights,
    explaining: tuple[str, ...],
    leaves_gap: bool,
    listed_share: float = DEFAULT_VERDICT.listed_share,
) -> dict[tuple[str, ...], float]:
    """Weights after most of that of `unknown` went to sets of effects, in proportion to theirs.

    Where a set explains most of a large gap, or a part of it: what is outside the list hardly ever
    looks so much like what is on it. Smaller sets, which do not, get nothing.

    Args:
        share: Weights with `unknown`.
        explaining: Names of the set.
        leaves_gap: The set leaves a gap: something acts beside it.
        listed_share: Share of the weight of `unknown` that goes to sets [-].
    """
    by_set = weight_by_set({k: w for k, w in share.items() if k not in ((NONE,), (UNKNOWN,))})
    by_set = {names: weight for names, weight in by_set.items() if len(names) >= len(explaining)}
    if not any(by_set.values()):
        by_set = {explaining: 1.0}  # weights too small for a number
    moved = listed_share * share[(UNKNOWN,)]
    believed = {**share, (UNKNOWN,): share[(UNKNOWN,)] - moved}
    for names, weight in by_set.items():
        whole = (*names, UNKNOWN) if leaves_gap else names
        part = weight / sum(by_set.values())
        believed[whole] = believed.get(whole, 0.0) + moved * part
    return believed


def weights_without(share: Weights, dropped: tuple[str, ...]) -> dict[tuple[str, ...], float]:
    """Weights without a set of effects, alone and beside `unknown`.

    `unknown` alone has all of it where those of the others are too small for a number.

    Args:
        share: Weights.
        dropped: Names of the set.
    """
    kept = {k: w for k, w in share.items() if k not in (dropped, (*dropped, UNKNOWN))}
    if not any(kept.values()):
        kept[(UNKNOWN,)] = 1.0
    total = sum(kept.values())
    return {names: weight / total for names, weight in kept.items()}


def weight_by_name(share: Weights) -> dict[str, float]:
    """Weight of each name, summed over the explanations it is part of, heaviest first."""
    total: dict[str, float] = {}
    for names, weight in share.items():
        for name in reported_names(names):
            total[name] = total.get(name, 0.0) + weight
    return dict(sorted(total.items(), key=lambda each: -each[1]))


def hypothesis_behind(
    found: ScreeningResult,
    leading: Sequence[Hypothesis],
    share: Weights,
    verdict: tuple[str, ...],
) -> Hypothesis:
    """Return the hypothesis of the verdict.

    The reference model for "none", the most probable listed hypothesis for "unknown".

    Args:
        found: For the reference model.
        leading: The hypotheses that were weighed beside it.
        share: Weights.
        verdict: By `decide`.
    """
    if verdict == (NONE,):
        return found.none
    if verdict == (UNKNOWN,):
        by_set = weight_by_set(share)
        return max(leading, key=lambda each: by_set[each.names], default=found.none)
    return next(each for each in leading if each.names == verdict)


def competing_hypotheses(
    found: ScreeningResult,
    leading: Sequence[Hypothesis],
    share: Weights,
    verdict: tuple[str, ...],
    settings: VerdictSettings = DEFAULT_VERDICT,
) -> list[Hypothesis]:
    """The other explanations that a run should tell from the verdict, the most probable first.

    The first needs `settings.min_competing_weight`, the others enough to be named beside it.

    Args:
        found: For the reference model.
        leading: The hypotheses that were weighed beside it.
        share: Weights.
        verdict: By `decide`; "unknown" has no competitors.
        settings: Numbers of the verdict.
    """
    if verdict == (UNKNOWN,):
        return []
    others = {each.names or (NONE,): each for each in (found.none, *leading)}
    by_set = weight_by_set(share)
    # Two forms of one effect need no telling apart.
    known, competing = {frozenset(reported_names(verdict))}, []
    for names in sorted(others, key=lambda names: -by_set[names]):
        least = settings.min_named_weight if competing else settings.min_competing_weight
        if by_set[names] < least or len(competing) == settings.max_competing:
            break
        if frozenset(reported_names(names)) not in known:
            known.add(frozenset(reported_names(names)))
            competing.append(others[names])
    return competing


def _total(ranked: Sequence[tuple[tuple[str, ...], float]]) -> float:
    return sum(weight for _, weight in ranked)
