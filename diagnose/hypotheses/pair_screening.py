"""Pairs of effects: which of all that there are are worth a simulation.

A pair begins with a single that was settled. Another effect is added to it on straight lines: from
the null, or, where it was settled alone as well, by what it did to the runs there. The first knows
every effect, but small strengths alone; the second holds far from the null, too.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from diagnose.hypotheses.hypothesis import (
    CORRECTED_ERR,
    STRENGTH_BELIEF,
    Hypothesis,
    least_changes,
    linear_start,
    lower_bounds,
    refine,
    top_ranked,
)
from diagnose.linear.linear_fit import ORDERS, LinearFit, fit_linear, floor_inflation
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel, predict
from drftjax.effects.catalogue import reported_names

# Singles that pairs begin with, pairs simulated, and how often each is at most.
BEGINNINGS, PAIRS, TURNS = 3, 8, 4


# While the best pair misses a block by more than so many of a model's own errors, the next ones are
# simulated, so many rounds in all.
FAR, ROUNDS = 5.0, 2


# So many of the leading pairs are simulated from the other kind of start as well.
TWICE = 3


# Width of the belief about how much of a settled effect acts beside another.
SHARE_BELIEF = 2.0


# Shares of the worst block's distance that floors are raised to where effects are settled.
SETTLED_ORDERS = (0.3, 0.0)


@dataclass(frozen=True)
class PairCandidate:
    """A pair as straight lines give it.

    Attributes:
        names: Its effects.
        from_null: Whether the second effect starts at its null, or from what it did alone.
        score: What the lines promise.
        build: Makes the hypothesis, with the way ahead of it.
    """

    names: frozenset[str]
    from_null: bool
    score: float
    build: Callable[[], Hypothesis]


def refine_pairs(bench: Regressors, singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The leading pairs, each settled by some simulations.

    Args:
        bench: The case.
        singles: Effects simulated alone, best first.
    """
    starts: dict[frozenset[str], dict[bool, PairCandidate]] = {}
    for each in pair_candidates(bench, singles):
        # Two forms of one effect are no pair: the verdict would name one, with two sets of numbers.
        if len(reported_names(each.names)) == 1:
            continue
        starts.setdefault(each.names, {}).setdefault(each.from_null, each)
    ways = list(starts.values())
    found: list[Hypothesis] = []
    for first in range(0, PAIRS * ROUNDS, PAIRS):
        begun = [next(iter(kinds.values())).build() for kinds in ways[first : first + PAIRS]]
        bench.dataset.precompile(predict, [each.model for each in begun])
        found += bench.dataset.map_items(lambda each: refine(bench, each, TURNS), begun)
        found.sort(key=lambda each: -each.score)
        # Far from the null straight lines may rank the pair that explains the runs low.
        if (
            not found
            or floor_inflation(bench.gram_matrices.blocks, found[0].fit.mean_square, 1.0) <= FAR
        ):
            break
    # Far from the null neither start is sure to lead to the best.

    def better(known: Hypothesis) -> Hypothesis:
        others = list(starts[frozenset(known.names)].values())[1:]
        again = [refine(bench, other.build(), TURNS) for other in others]
        return max([known, *again], key=lambda each: each.score)

    return [*bench.dataset.map_items(better, found[:TWICE]), *found[TWICE:]]


def pair_candidates(bench: Regressors, singles: Sequence[Hypothesis]) -> Iterator[PairCandidate]:
    """Pairs as straight lines give them, the orders taking turns; one may come more than once.

    Arguments as for `simulated_pairs`.
    """
    orders = []
    # Another form of an effect begins nothing that the better one does not.
    beginnings: dict[tuple[str, ...], Hypothesis] = {}
    for each in top_ranked(singles, BEGINNINGS):
        beginnings.setdefault(reported_names(each.names), each)
    for propose in (_with_settled, _with_any):
        of_each = [propose(bench, each, singles) for each in beginnings.values()]
        for every in zip(*of_each, strict=True):
            together = itertools.chain.from_iterable(every)
            orders.append(sorted(together, key=lambda each: -each.score))
    for turn in itertools.zip_longest(*orders):
        yield from (each for each in turn if each is not None)


def _with_settled(
    bench: Regressors, first: Hypothesis, singles: Sequence[Hypothesis]
) -> list[list[PairCandidate]]:
    """A single with each of the others, as much of it as is wanted of what that did alone."""
    others = [each for each in singles if each.is_simulated and each is not first]
    columns = [
        np.concatenate([first.columns[run], *(_did(bench, each, run) for each in others)], axis=2)
        for run in range(len(first.residual))
    ]
    products = bench.gram_matrices_of(columns, first.residual, first.log_zeta)
    count = len(first.coordinates)
    found = []
    for share in SETTLED_ORDERS:
        coarse = floor_inflation(bench.gram_matrices.blocks, singles[0].fit.mean_square, share)
        order = []
        for place, other in enumerate(others):
            one_sign = any(
                least == 0 for each in other.model.effects for least in lower_bounds(each)
            )
            line = fit_linear(
                products,
                [*range(count), count + place],
                prior=np.r_[np.full(count, STRENGTH_BELIEF), SHARE_BELIEF],
                least=np.r_[least_changes(first), 0.0 if one_sign else -np.inf],
                trust=CORRECTED_ERR,
                coarse=coarse,
            )
            names = frozenset((*first.names, *other.names))
            order.append(
                PairCandidate(
                    names, False, line.score, partial(_both_settled, bench, first, other, line)
                )
            )
        found.append(order)
    return found


def _did(bench: Regressors, single: Hypothesis, run: int) -> np.ndarray:
    """What a settled single, its own zeta with it, changed of a run; one column."""
    return (single.residual[run] - bench.residual[run])[:, :, None]


def _both_settled(
    bench: Regressors, first: Hypothesis, other: Hypothesis, line: LinearFit
) -> Hypothesis:
    share = line.coefficients[-1]
    shape = np.array([free.scale is None for free in other.model.free])
    null = np.where(shape, other.coordinates, 0.0)
    zeta = line.log_zeta_change + share * (other.log_zeta - bench.log_zeta)
    change = np.r_[line.coefficients[:-1], share * (other.coordinates - null)]
    return _joined(first, other.model, null, other.columns, line, (zeta, change))


def _with_any(
    bench: Regressors, first: Hypothesis, singles: Sequence[Hypothesis]
) -> list[list[PairCandidate]]:
    """A single with any other effect from its null, by each of the orders."""
    columns = [
        np.concatenate([mine, theirs[:, :, 1:]], axis=2)
        for mine, theirs in zip(first.columns, bench.columns, strict=True)
    ]
    products = bench.gram_matrices_of(columns, first.residual, first.log_zeta)
    count = len(first.coordinates)
    found = []
    for share, trust in ORDERS:
        coarse = floor_inflation(bench.gram_matrices.blocks, singles[0].fit.mean_square, share)
        best: dict[str, tuple[ShapeVariant, LinearFit]] = {}
        for variant in bench.variants:
            name = variant.effect.about.name
            if name in first.names:
                continue
            taken = [*range(count), *(count + column for column in variant.columns)]
            line = fit_linear(
                products,
                taken,
                prior=np.full(len(taken), STRENGTH_BELIEF),
                least=np.r_[least_changes(first), lower_bounds(variant.effect)],
                trust=trust,
                coarse=coarse,
            )
            if name not in best or line.score > best[name][1].score:
                best[name] = variant, line
        found.append(
            [
                PairCandidate(
                    frozenset((*first.names, name)),
                    True,
                    line.score,
                    partial(_from_null, bench, first, variant, line),
                )
                for name, (variant, line) in best.items()
            ]
        )
    return found


def _from_null(
    bench: Regressors, first: Hypothesis, variant: ShapeVariant, line: LinearFit
) -> Hypothesis:
    count = len(first.coordinates)
    own = LinearFit(
        line.score,
        line.coefficients[count:],
        line.log_zeta_change,
        line.mean_square,
        line.zeta_variance,
    )
    added = linear_start(bench, [variant], own)
    assert added.proposed_step is not None
    change = np.r_[line.coefficients[:count], added.proposed_step[1]]
    ahead = line.log_zeta_change, change
    return _joined(first, added.model, added.coordinates, added.columns, line, ahead)


def _joined(
    first: Hypothesis,
    model: AugmentedModel,
    coordinates: np.ndarray,
    columns: Sequence[np.ndarray],
    line: LinearFit,
    ahead: tuple[np.ndarray, np.ndarray],
) -> Hypothesis:
    """A settled single with another effect at its null, and the way ahead of both."""
    both = [
        np.concatenate([mine, more[:, :, 1:]], axis=2)
        for mine, more in zip(first.columns, columns, strict=True)
    ]
    return Hypothesis(
        AugmentedModel(first.model.effects + model.effects),
        first.log_zeta,
        np.r_[first.coordinates, coordinates],
        line,
        both,
        first.residual,
        is_simulated=False,
        proposed_step=ahead,
    )
