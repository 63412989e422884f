"""Ranking of effects by linear fits, alone or beside a refined hypothesis."""

from collections.abc import Sequence

import numpy as np

from diagnose.hypotheses.hypothesis import linear_fit_of, lower_bounds
from diagnose.linear.linear_fit import (
    FitRequest,
    GramMatrices,
    LinearFit,
    LinearFitSettings,
    fit_each,
    floor_inflation,
)
from diagnose.linear.regressors import Regressors, ShapeVariant

# Numbers of a ranking by linear fits: the share of the worst block's RMS in model errors that model
# errors are raised to, and the share of a response that may be wrong for being linear.
Ranking = tuple[float, float]


# Where the gap is large, an error for being linear hides what an effect explains. The last ranking
# takes linear responses at their word: an effect that zeta all but makes up for is small only on
# the whole.
DEFAULT_RANKINGS: tuple[Ranking, ...] = ((0.3, 0.1), (0.1, 0.1), (0.0, 0.1), (0.0, 0.0))


def fits_beside(
    matrices: GramMatrices,
    lower: np.ndarray,
    sets: Sequence[Sequence[ShapeVariant]],
    miss: np.ndarray,
    rankings: Sequence[Ranking],
    settings: LinearFitSettings,
) -> list[list[LinearFit]]:
    """Linear fits of sets of further effects beside a hypothesis.

    Args:
        matrices: Gram matrices of a hypothesis's columns, and of the regressors' behind them.
        lower: Lower bound of the change of each of its coordinates; empty beside no effect.
        sets: Effects that may be added to it, one or several at once.
        miss: Mean square that is left in each block without them, shape (blocks,).
        rankings: Numbers of the fits.
        settings: Weights of the fits.

    Returns:
        By ranking, one of each set.
    """
    count = len(lower)
    inflation = [floor_inflation(matrices.blocks, miss, share, settings) for share, _ in rankings]
    found: dict[tuple[int, int], LinearFit] = {}
    taken = [[count + column for each in several for column in each.columns] for several in sets]
    # Fits of as many columns are made side by side.
    for size in sorted({len(each) for each in taken}):
        alike = [place for place, each in enumerate(taken) if len(each) == size]
        bounds = [[b for each in sets[k] for b in lower_bounds(each.effect)] for k in alike]
        columns = np.tile([[*range(count), *taken[k]] for k in alike], (len(rankings), 1))
        request = FitRequest(
            columns,
            np.full(columns.shape, settings.strength_prior),
            np.zeros(columns.shape),
            np.tile([[*lower, *each] for each in bounds], (len(rankings), 1)),
            np.repeat([error for _, error in rankings], len(alike)),
            np.repeat(inflation, len(alike)),
        )
        keys = [(ranking, place) for ranking in range(len(rankings)) for place in alike]
        found |= zip(keys, fit_each(matrices, request, settings), strict=True)
    every = range(len(sets))
    return [[found[ranking, place] for place in every] for ranking in range(len(rankings))]


def best_variants(
    matrices: GramMatrices,
    lower: np.ndarray,
    variants: Sequence[ShapeVariant],
    miss: np.ndarray,
    rankings: Sequence[Ranking],
    settings: LinearFitSettings,
) -> list[dict[str, tuple[ShapeVariant, LinearFit]]]:
    """The best variant of each effect and its linear fit, by each of some rankings.

    Arguments as for `fits_beside`, with the variants that may be added one by one.

    Returns:
        By ranking, by name of the effect.
    """
    alone = [(each,) for each in variants]
    best: list[dict[str, tuple[ShapeVariant, LinearFit]]] = []
    for fits in fits_beside(matrices, lower, alone, miss, rankings, settings):
        leading: dict[str, tuple[ShapeVariant, LinearFit]] = {}
        for variant, fit in zip(variants, fits, strict=True):
            name = variant.effect.about.name
            if name not in leading or fit.score > leading[name][1].score:
                leading[name] = variant, fit
        best.append(leading)
    return best


def ranked_effects(
    regressors: Regressors, rankings: Sequence[Ranking], least_count: int, min_gain: float
) -> list[tuple[ShapeVariant, LinearFit]]:
    """The best variant of each effect that gains, the rankings taking turns.

    Args:
        regressors: The runs.
        rankings: Numbers of the fits.
        least_count: So many come in any case.
        min_gain: The others only where a linear fit by one of the rankings gains more log score
            than this over one without an effect [-].

    Returns:
        Variants, each with its fit by the ranking that named it first.
    """
    matrices, weights = regressors.gram_matrices, regressors.settings
    miss = linear_fit_of(regressors, []).mean_square
    each_of = regressors.variants, miss, rankings, weights
    orders = []
    gaining: set[str] = set()
    for best, (share, linear_error) in zip(
        best_variants(matrices, np.zeros(0), *each_of), rankings, strict=True
    ):
        inflation = floor_inflation(matrices.blocks, miss, share, weights)
        without = linear_fit_of(regressors, [], inflation, linear_error).score
        orders.append(sorted(best.values(), key=lambda each: -each[1].score))
        gaining |= {name for name, (_, fit) in best.items() if fit.score > without + min_gain}
    found: dict[str, tuple[ShapeVariant, LinearFit]] = {}
    for turn in zip(*orders, strict=True):
        for variant, fit in turn:
            found.setdefault(variant.effect.about.name, (variant, fit))
    return [
        each
        for place, (name, each) in enumerate(found.items())
        if place < least_count or name in gaining
    ]
