"""Sets of several effects: which of them are worth a simulation.

A set begins with a smaller one that was refined: a single effect, a pair. Another effect is added
to it by a linear fit: from its null, or, where it was refined alone as well, by the change that it
made to the runs there. The first kind of start covers every effect, but only small strengths; the
second holds far from the null, too. Beside two effects or more, responses from the null are taken
at the set's numbers.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from diagnose.hypotheses.exact_responses import FurtherResponses, exact_responses
from diagnose.hypotheses.hypothesis import (
    Hypothesis,
    least_changes,
    linear_start,
    lower_bounds,
    top_ranked,
)
from diagnose.hypotheses.linear_ranking import DEFAULT_RANKINGS, Ranking, best_variants
from diagnose.linear.linear_fit import LinearFit, fit_linear, floor_inflation, log_score
from diagnose.linear.regressors import Regressors, ShapeVariant
from diagnose.model.augmented_model import AugmentedModel
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_names


@dataclass(frozen=True)
class SetScreeningSettings:
    """Numbers by which sets of effects are chosen for simulation.

    Attributes:
        max_bases: Refined hypotheses that sets begin with, at most. Singles that look alike, such
            as two kinds of drag, lead with nearly one score.
        max_deficit: Of these none that is further behind the best in log score [-].
        number_cost: Log score that each number must gain by which one form of an effect has more
            than another [-]: what it costs in a weight, whose evidence counts half as much.
        max_astray: Further sets that get more, where a linear fit puts them before the best that
            was reached and the first simulation went far, to where they did worse.
        max_per_effect: Sets that one effect is added to before those with other effects come.
        min_correlation: Sets change the runs alike where the changes that their linear fits propose
            have this correlation, in model errors, at least [-]. A pull, friction, a smaller wheel
            and sand pushed ahead do.
        max_correlated: Of sets that do, so many before others come. Which of the effects it is is
            asked in the end, where look-alikes take each other's place.
        max_compared: Sets that are compared so for each that is simulated, at most.
        sets_per_round: Sets that are simulated.
        max_simulations: Simulations of all runs for each set, at most.
        max_continued: Sets that get more than one: those that lead after it. Where the reference
            model is far off one simulation does not tell, and all get more.
        both_starts: Leading sets that are refined from the other kind of start as well, as neither
            is sure to lead to the best.
        far_both_starts: The same where the reference model is far off.
        far_bases: Leading bases beside which effects are tried at strengths far from zero, where
            the reference model is far off.
        max_retries: Sets that do worse than a part of them, from which they may begin, are refined
            again from there, so many at most. None but where the reference model is far off.
        fresh_derivatives: Where the reference model is far off those that go on get derivatives by
            the simulator first. Else, and in larger sets, one effect more is a short way, on which
            Broyden's update does as well.
        share_prior: Width of the prior on how much of a refined effect acts beside another [-].
        rankings: Linear fits rank sets with an effect at its null once by each of these.
        refined_floor_shares: Shares of the worst block's RMS in model errors that model errors are
            raised to in the rankings of sets of refined effects [-].
    """

    max_bases: int = 4
    max_deficit: float = np.inf
    number_cost: float = 3.0
    max_per_effect: int = 2
    min_correlation: float = 0.95
    max_correlated: int = 2
    max_compared: int = 3
    sets_per_round: int = 13
    max_simulations: int = 3
    max_continued: int = 8
    max_astray: int = 2
    both_starts: int = 2
    far_both_starts: int = 13
    far_bases: int = 2
    max_retries: int = 4
    fresh_derivatives: bool = True
    share_prior: float = 2.0
    rankings: tuple[Ranking, ...] = DEFAULT_RANKINGS
    refined_floor_shares: tuple[float, ...] = (0.3, 0.0)

    def where(self, is_far: bool) -> "SetScreeningSettings":
        """The numbers where the reference model is far off, or is not."""
        if is_far:
            both_starts = self.far_both_starts
            return replace(self, max_continued=self.sets_per_round, both_starts=both_starts)
        return replace(self, max_retries=0, far_bases=0, fresh_derivatives=False)


DEFAULT_PAIRS = SetScreeningSettings()

# A base of two effects or more is simulated and linearised again, so linear fits about it are
# nearer to the truth than those about the reference model: fewer tries are enough.
DEFAULT_LARGER_SETS = SetScreeningSettings(
    max_bases=3,
    max_deficit=100.0,
    max_per_effect=1,
    sets_per_round=8,
    max_continued=3,
    both_starts=1,
    far_both_starts=1,
    far_bases=0,
    fresh_derivatives=False,
)


# A further effect's shapes and its responses beside a set, by run, by its name.
GivenResponses = dict[str, tuple[ShapeVariant, list[np.ndarray]]]

# By ranking, by name: an effect's best variant beside a base, and its linear fit.
LeadingVariants = list[dict[str, tuple[ShapeVariant, LinearFit]]]


@dataclass(frozen=True)
class SetCandidate:
    """A set of effects as a linear fit proposes it.

    Attributes:
        names: Its effects.
        from_null: The added effect starts at its null, not from its refinement alone.
        score: Log score that the fit predicts.
        base: The hypothesis that the effect is added to.
        build: Makes the hypothesis, with its proposed step.
    """

    names: frozenset[str]
    from_null: bool
    score: float
    base: Hypothesis
    build: Callable[[], Hypothesis]

    @property
    def has_two_forms(self) -> bool:
        """Two forms of one effect are in it: a verdict would name one, with two sets of numbers."""
        return len(reported_names(self.names)) < len(self.names)


def set_candidates(
    regressors: Regressors,
    bases: Sequence[Hypothesis],
    singles: Sequence[Hypothesis],
    pool: RunPool,
    settings: SetScreeningSettings = DEFAULT_PAIRS,
) -> Iterator[SetCandidate]:
    """Sets that linear fits propose, the rankings taking turns; one may come more than once.

    One ranking, two of pairs, is by what each effect does alone, simulated: no linear fit is in it.

    Arguments as for `refine_sets`.
    """
    firsts = leading_bases(bases, settings)
    miss, rankings = bases[0].fit.mean_square, settings.rankings
    by_base = pool.map_outer(
        lambda each: leading_beside(regressors, each, miss, pool, rankings), firsts
    )
    given = exact_beside(regressors, firsts[0], by_base[:1], pool)
    refined = pool.map_outer(
        lambda each: _with_refined(regressors, each, miss, singles, pool, settings), firsts
    )
    by_score, by_part = _by_what_each_does_alone(regressors, refined, singles)
    orders = [by_score]
    for of_each in (
        refined,
        pool.map_outer(
            lambda base: with_any(regressors, *base, miss, pool, rankings, given),
            zip(firsts, by_base, strict=True),
        ),
    ):
        for every in itertools.zip_longest(*of_each, fillvalue=()):
            together = itertools.chain.from_iterable(every)
            orders.append(sorted(together, key=lambda each: -each.score))
    if len(firsts[0].names) == 1:
        orders.append(by_part)
    return taking_turns(orders)


def taking_turns(orders: Sequence[Sequence[SetCandidate]]) -> Iterator[SetCandidate]:
    """The first of each order, then the second of each, and so on."""
    for turn in itertools.zip_longest(*orders):
        yield from (each for each in turn if each is not None)


def _by_what_each_does_alone(
    regressors: Regressors,
    refined: Sequence[Sequence[Sequence[SetCandidate]]],
    singles: Sequence[Hypothesis],
) -> list[list[SetCandidate]]:
    """Sets of a base and a refined single, by two rankings.

    One adds their scores. By the other each leaves what the better of the two does: in every block,
    and of zeta's scatter. It leads to two effects that explain different things.

    Args:
        regressors: The runs.
        refined: By base, by ranking.
        singles: Effects simulated alone.
    """
    alone = {each.names: each for each in singles}
    matrices, runs = regressors.gram_matrices, len(regressors.log_zeta)
    blocks, count = matrices.blocks, matrices.sample_count.sum(axis=0)

    def parts(each: SetCandidate) -> tuple[Hypothesis, Hypothesis]:
        (added,) = each.names.difference(each.base.names)
        return each.base, alone[added,]

    def together(each: SetCandidate) -> float:
        return sum(part.score for part in parts(each))

    def best_of_both(each: SetCandidate) -> float:
        base, added = (part.fit for part in parts(each))
        left = np.minimum(base.mean_square, added.mean_square)
        scatter = min(base.zeta_variance, added.zeta_variance)
        return log_score(blocks, count, left, scatter, runs, settings=regressors.settings)

    # The last ranking takes the singles' changes of the runs at their word.
    every = [each for by_share in refined for each in by_share[-1]]
    return [sorted(every, key=by, reverse=True) for by in (together, best_of_both)]


def leading_bases(bases: Sequence[Hypothesis], settings: SetScreeningSettings) -> list[Hypothesis]:
    """The hypotheses that sets begin with, each in the form of its effects that is worth most.

    Args:
        bases: Best first.
        settings: Numbers of the choice.
    """
    firsts: dict[tuple[str, ...], Hypothesis] = {}
    for each in top_ranked(bases, settings.max_bases):
        if each.score <= bases[0].score - settings.max_deficit:
            continue
        known = firsts.setdefault(reported_names(each.names), each)
        further = len(each.coordinates) - len(known.coordinates)
        if each.score > known.score + settings.number_cost * further:
            firsts[reported_names(each.names)] = each
    return list(firsts.values())


def _with_refined(
    regressors: Regressors,
    first: Hypothesis,
    miss: np.ndarray,
    singles: Sequence[Hypothesis],
    pool: RunPool,
    settings: SetScreeningSettings,
) -> list[list[SetCandidate]]:
    """A base with a share of each single's change of the runs, by each of the rankings.

    `miss` is what the best base leaves in each block.
    """
    others = [e for e in singles if e.is_simulated and not set(e.names) & set(first.names)]
    columns = [
        np.concatenate(
            [first.columns[run], *(_change_by(regressors, each, run) for each in others)], axis=2
        )
        for run in range(len(first.residual))
    ]
    matrices = regressors.gram_matrices_of(columns, first.residual, first.log_zeta, pool)
    count, weights = len(first.coordinates), regressors.settings
    found = []
    for share in settings.refined_floor_shares:
        inflation = floor_inflation(matrices.blocks, miss, share, weights)
        order = []
        for place, other in enumerate(others):
            fit = fit_linear(
                matrices,
                [*range(count), count + place],
                prior=np.r_[np.full(count, weights.strength_prior), settings.share_prior],
                lower=np.r_[least_changes(first), 0.0 if _has_one_sign(other) else -np.inf],
                linear_error=weights.corrected_error,
                inflation=inflation,
                settings=weights,
            )
            build = partial(_join_refined, regressors, first, other, fit)
            names = frozenset((*first.names, *other.names))
            order.append(SetCandidate(names, False, fit.score, first, build))
        found.append(order)
    return found


def _has_one_sign(single: Hypothesis) -> bool:
    return any(least == 0 for each in single.model.effects for least in lower_bounds(each))


def _change_by(regressors: Regressors, single: Hypothesis, run: int) -> np.ndarray:
    """Change of a run by a refined single and its own zeta, shape (channels, samples, 1)."""
    return (single.residual[run] - regressors.residual[run])[:, :, None]


def _join_refined(
    regressors: Regressors, first: Hypothesis, other: Hypothesis, fit: LinearFit
) -> Hypothesis:
    share = fit.coefficients[-1]
    shape = np.array([free.scale is None for free in other.model.free])
    null = np.where(shape, other.coordinates, 0.0)
    zeta = fit.log_zeta_change + share * (other.log_zeta - regressors.log_zeta)
    change = np.r_[fit.coefficients[:-1], share * (other.coordinates - null)]
    return joined(first, other.model, null, other.columns, fit, (zeta, change))


def exact_beside(
    regressors: Regressors,
    best: Hypothesis,
    leading: Sequence[LeadingVariants],
    pool: RunPool,
) -> GivenResponses:
    """Responses to further effects at the numbers of a set; none beside a single effect.

    Args:
        regressors: The runs.
        best: The set.
        leading: By base, the further effects' best variants beside it. The bases are about as good
            as the set, so they move the runs much as it does: its responses stand for theirs, too.
        pool: Threads.
    """
    if len(best.names) < 2:
        return {}
    # Of each effect the shapes that do best by the last ranking, beside the first base with it.
    chosen: dict[str, ShapeVariant] = {}
    for each in leading:
        for name, (variant, _) in each[-1].items():
            if name not in best.names:
                chosen.setdefault(name, variant)
    exact = exact_responses(regressors, best, list(chosen.values()), pool)
    return {name: (chosen[name], responses) for name, responses in exact.items()}


def leading_beside(
    regressors: Regressors,
    first: Hypothesis,
    miss: np.ndarray,
    pool: RunPool,
    rankings: Sequence[Ranking],
) -> LeadingVariants:
    """By ranking, the best variant of every other effect beside a base, and its linear fit.

    Args:
        regressors: The runs.
        first: The base.
        miss: Mean square that is left in each block without them, shape (blocks,).
        pool: Threads.
        rankings: Numbers of the linear fits.
    """
    of_run = first.columns, first.residual, first.log_zeta
    matrices = regressors.gram_matrices_beside_all(*of_run, pool)
    others = [v for v in regressors.variants if v.effect.about.name not in first.names]
    weights = regressors.settings
    return best_variants(matrices, least_changes(first), others, miss, rankings, weights)


def with_any(
    regressors: Regressors,
    first: Hypothesis,
    best: LeadingVariants,
    miss: np.ndarray,
    pool: RunPool,
    rankings: Sequence[Ranking],
    given: GivenResponses,
) -> list[list[SetCandidate]]:
    """A base with any other effect from its null, by each of the rankings.

    Args:
        regressors: The runs.
        first: The base.
        best: The other effects' best variants, by responses about the reference model.
        miss, pool, rankings: As for `leading_beside`.
        given: Responses that take the place of those.
    """
    exact = {name: responses for name, (_, responses) in given.items()}
    if given:
        chosen = {name: variant for name, (variant, _) in best[-1].items()}
        chosen |= {name: variant for name, (variant, _) in given.items() if name in chosen}
        further = FurtherResponses.of(regressors, first, list(chosen.values()), exact)
        of_run = further.columns, first.residual, first.log_zeta
        matrices, weights = regressors.gram_matrices_of(*of_run, pool), regressors.settings
        of_each = further.variants, miss, rankings, weights
        best = best_variants(matrices, least_changes(first), *of_each)
        best = [{name: (chosen[name], fit) for name, (_, fit) in each.items()} for each in best]
    found = []
    for leading in best:
        order = []
        for name, (variant, fit) in leading.items():
            build = partial(joined_from_null, regressors, first, [variant], fit, exact.get(name))
            names = frozenset((*first.names, name))
            order.append(SetCandidate(names, True, fit.score, first, build))
        found.append(order)
    return found


def joined_from_null(
    regressors: Regressors,
    first: Hypothesis,
    variants: Sequence[ShapeVariant],
    fit: LinearFit,
    exact: Sequence[np.ndarray] | None = None,
) -> Hypothesis:
    """A hypothesis with further effects from their null, as a linear fit of all proposes.

    Args:
        regressors: The runs.
        first: The hypothesis.
        variants: The effects.
        fit: Of the hypothesis's coordinates, and of the effects' strengths behind them.
        exact: By run, derivatives by the strengths of the one effect beside the hypothesis, shape
            (channels, samples, strengths); those of the regressors where they are not given.
    """
    count = len(first.coordinates)
    own = replace(fit, coefficients=fit.coefficients[count:])
    added = linear_start(regressors, variants, own)
    assert added.proposed_step is not None
    change = np.r_[fit.coefficients[:count], added.proposed_step[1]]
    step = fit.log_zeta_change, change
    columns = added.columns
    if exact is not None:
        columns = [
            np.concatenate([mine[:, :, :1], given, mine[:, :, 1 + given.shape[2] :]], axis=2)
            for mine, given in zip(columns, exact, strict=True)
        ]
    return joined(first, added.model, added.coordinates, columns, fit, step)


def joined(
    first: Hypothesis,
    model: AugmentedModel,
    coordinates: np.ndarray,
    columns: Sequence[np.ndarray],
    fit: LinearFit,
    step: tuple[np.ndarray, np.ndarray],
) -> Hypothesis:
    """A refined base with further effects, and the step that is proposed for all.

    Args:
        first: The base.
        model, coordinates: The further effects and their numbers.
        columns: By run, derivatives by (own log zeta, these numbers).
        fit: What is known of all together.
        step: Change of the runs' log zeta [-], and of the coordinates, the base's first.
    """
    both = [
        np.concatenate([mine, more[:, :, 1:]], axis=2)
        for mine, more in zip(first.columns, columns, strict=True)
    ]
    return Hypothesis(
        AugmentedModel(first.model.effects + model.effects),
        first.log_zeta,
        np.r_[first.coordinates, coordinates],
        fit,
        both,
        first.residual,
        is_simulated=False,
        proposed_step=step,
        start_score=first.score if first.is_simulated else -np.inf,
    )
