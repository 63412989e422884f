"""Sets of several effects: those that linear fits propose, simulated."""

from collections.abc import Sequence

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, best_of_each
from diagnose.hypotheses.refinement import (
    DEFAULT_REFINEMENT,
    RefinementSettings,
    at_its_start,
    predicted_score,
    refine,
    relinearize,
)
from diagnose.hypotheses.set_candidates import (
    DEFAULT_PAIRS,
    SetCandidate,
    SetScreeningSettings,
    set_candidates,
)
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool

# By names of a set, by (whether the added effect starts at its null, names of the base).
Starts = dict[frozenset[str], dict[tuple[bool, tuple[str, ...]], SetCandidate]]


def refine_sets(
    regressors: Regressors,
    bases: Sequence[Hypothesis],
    singles: Sequence[Hypothesis],
    pool: RunPool,
    settings: SetScreeningSettings = DEFAULT_PAIRS,
    refinement: RefinementSettings = DEFAULT_REFINEMENT,
) -> list[Hypothesis]:
    """Simulate the leading sets of one effect more, each refined by some simulations.

    Args:
        regressors: The runs.
        bases: Hypotheses that an effect is added to, best first.
        singles: Effects simulated alone, best first.
        pool: Threads.
        settings: Numbers of the choice.
        refinement: Numbers of the refinement.

    Returns:
        Best first.
    """
    starts: Starts = {}
    for each in set_candidates(regressors, bases, singles, pool, settings):
        if each.has_two_forms:
            continue
        key = each.from_null, each.base.names
        starts.setdefault(each.names, {}).setdefault(key, each)
    starts = varied(starts, settings.max_per_effect)
    starts = unlike_first(regressors, starts, pool, settings)

    def other_kind(known: Hypothesis) -> list[SetCandidate]:
        first, *others = starts[frozenset(known.names)].values()
        return [each for each in others if each.from_null != first.from_null][:1]

    def best_base(known: Hypothesis) -> Hypothesis:
        every = starts[frozenset(known.names)].values()
        return max((each.base for each in every), key=lambda each: each.score)

    tried: set[int] = set()

    def from_best_base(known: Hypothesis) -> list[SetCandidate]:
        every, base = starts[frozenset(known.names)].values(), best_base(known)
        return [each for each in every if each.base is base and id(each) not in tried]

    def simulated(candidates: Sequence[SetCandidate]) -> list[Hypothesis]:
        tried.update(map(id, candidates))
        begun = [each.build() for each in candidates]
        return race(regressors, begun, pool, settings, refinement) if begun else []

    def with_better(known: list[Hypothesis], others: Sequence[SetCandidate]) -> list[Hypothesis]:
        return best_of_each([*known, *(each for each in simulated(others) if each.is_simulated)])

    firsts = [next(iter(kinds.values())) for kinds in starts.values()]
    found = best_of_each(simulated(firsts[: settings.sets_per_round]))
    leading = found[: settings.both_starts]
    found = with_better(found, [other for each in leading for other in other_kind(each)])
    # No set does worse than a part of it, unless its refinement went astray.
    ranks = {names: rank for rank, names in enumerate(starts)}
    astray = [e for e in found if e.score < best_base(e).score and from_best_base(e)]
    astray.sort(key=lambda each: ranks[frozenset(each.names)])
    again = [other for each in astray[: settings.max_retries] for other in from_best_base(each)]
    return with_better(found, again)


def varied(starts: Starts, max_per_effect: int) -> Starts:
    """Starts in the same order, but that no effect is added too often before others are.

    Beside bases that look alike, which lead with nearly one score, the same few gain most.

    Args:
        starts: By names of the set, best first.
        max_per_effect: Sets that one effect is added to before those with others come.
    """
    count: dict[frozenset[str], int] = {}
    early, late = [], []
    for names, kinds in starts.items():
        added = names - {*next(iter(kinds.values())).base.names}
        count[added] = count.get(added, 0) + 1
        (early if count[added] <= max_per_effect else late).append(names)
    return {names: starts[names] for names in (*early, *late)}


def unlike_first(
    regressors: Regressors, starts: Starts, pool: RunPool, settings: SetScreeningSettings
) -> Starts:
    """Starts in the same order, but that few which change the runs alike come before others.

    Args:
        regressors: The runs.
        starts: By names of the set, best first.
        pool: Threads.
        settings: What is alike, and how many of these come first.
    """
    leading = [*starts][: settings.max_compared * settings.sets_per_round]
    proposed = [next(iter(starts[names].values())) for names in leading]
    alike = _correlations(regressors, proposed, pool) > settings.min_correlation
    early, late = list[int](), list[int]()
    for place, is_alike in enumerate(alike):
        (early if is_alike[early].sum() < settings.max_correlated else late).append(place)
    first = [leading[place] for place in (*early, *late)]
    return {names: starts[names] for names in (*first, *starts)}


def _correlations(
    regressors: Regressors, candidates: Sequence[SetCandidate], pool: RunPool
) -> np.ndarray:
    """Correlation of the changes of all runs that candidates propose, in model errors [-].

    Returns:
        Shape (candidates, candidates); not a number for one that changes nothing.
    """
    if not candidates:
        return np.zeros((0, 0))

    def change(each: SetCandidate) -> list[np.ndarray]:
        start = each.build()
        assert start.proposed_step is not None
        log_zeta, coordinates = start.proposed_step
        return [
            columns @ np.r_[own, coordinates]
            for columns, own in zip(start.columns, log_zeta, strict=True)
        ]

    changes = pool.map_outer(change, candidates)
    by_run = [np.stack(of_run, axis=-1) for of_run in zip(*changes, strict=True)]
    about = regressors.residual, regressors.log_zeta
    matrices = regressors.gram_matrices_of(by_run, *about, pool)
    products = matrices.weighed(regressors.settings).sum(axis=0)[:-1, :-1]
    size = np.sqrt(np.diagonal(products))
    with np.errstate(invalid="ignore"):
        return products / np.outer(size, size)


def race(
    regressors: Regressors,
    starts: Sequence[Hypothesis],
    pool: RunPool,
    settings: SetScreeningSettings,
    refinement: RefinementSettings,
) -> list[Hypothesis]:
    """Refine the starts; only the leading ones get more than one simulation.

    One that does worse than without the effect which was added went astray, and is refined again
    from there. Some that went far get more simulations, too: a load, say, is made up for by a
    quarter of zeta, and what a linear fit promises may lie on the way.

    Args:
        regressors: The runs.
        starts: Hypotheses with a proposed step.
        pool: Threads.
        settings: Numbers of the choice.
        refinement: Numbers of the refinement.
    """

    def first(start: Hypothesis) -> tuple[Hypothesis, Hypothesis]:
        return start, refine(regressors, start, 1, pool, refinement)

    def went_far(start: Hypothesis, here: Hypothesis) -> bool:
        return np.abs(here.log_zeta - start.log_zeta).max() > refinement.min_detour

    def onward(here: Hypothesis, is_elsewhere: bool = False) -> Hypothesis:
        if (settings.fresh_derivatives or is_elsewhere) and here.is_simulated:
            here = relinearize(regressors, here, pool)
        return refine(regressors, here, settings.max_simulations - 1, pool, refinement)

    def further(both: tuple[Hypothesis, Hypothesis]) -> Hypothesis:
        start, here = both
        found = onward(here, went_far(start, here))
        if start.start_score == -np.inf or (found.is_simulated and found.score > start.start_score):
            return found
        again = onward(at_its_start(regressors, start, pool))
        return max([again, found], key=lambda each: each.score if each.is_simulated else -np.inf)

    begun = pool.map_outer(first, starts)
    begun.sort(key=lambda both: -predicted_score(regressors, both[1], pool))
    leading, rest = begun[: settings.max_continued], begun[settings.max_continued :]
    best = max((here.score for _, here in begun if here.is_simulated), default=-np.inf)
    astray = [both for both in rest if went_far(*both) and both[0].fit.score > best]
    astray.sort(key=lambda both: -both[0].fit.score)
    leading += astray[: settings.max_astray]
    rest = [both for both in rest if both not in leading]
    return [*pool.map_outer(further, leading), *(here for _, here in rest)]


def without_effect(whole: Hypothesis, index: int) -> Hypothesis:
    """A hypothesis without one of its effects, the others' numbers where they were.

    Args:
        whole: The hypothesis.
        index: Place of the effect.
    """
    kept = [k for k, free in enumerate(whole.model.free) if free.index != index]
    return Hypothesis(
        AugmentedModel(tuple(e for k, e in enumerate(whole.model.effects) if k != index)),
        whole.log_zeta,
        whole.coordinates[kept],
        whole.fit,
        [each[:, :, [0, *(1 + k for k in kept)]] for each in whole.columns],
        whole.residual,
        is_simulated=False,
        proposed_step=(np.zeros_like(whole.log_zeta), np.zeros(len(kept))),
    )
