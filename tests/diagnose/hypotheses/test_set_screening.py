"""Sets of effects: what each did alone leads to both, however far from the null."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses import set_candidates as set_candidates_module
from diagnose.hypotheses import set_screening
from diagnose.hypotheses.hypothesis import linear_fit_of, linear_start
from diagnose.hypotheses.refinement import (
    DEFAULT_REFINEMENT,
    at_its_start,
    refine,
    relinearize,
)
from diagnose.hypotheses.set_candidates import (
    DEFAULT_LARGER_SETS,
    DEFAULT_PAIRS,
    SetScreeningSettings,
    leading_bases,
    set_candidates,
)
from diagnose.hypotheses.set_screening import race, refine_sets, without_effect
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import shared_model
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import WITH_REST, dataset_with

# A way ahead leads each number to within a tenth, fitted alone to what both did: a start, which
# simulation then settles to what three short runs tell of it, a per cent or two.
START, TOLD = 0.1, 0.03
# The runs' own noise is 20 um, and plates and steps leave a part of it more [m].
LEFT = 30e-6
# Log score that noise alone gives a third effect on three short runs.
THIRD_GAINS = 8.0
# A damper, not friction: what friction does a pull does as well on a wheel that only goes forward,
# and its derivative hangs on rounding where the wheel nearly sticks.
TRUTH = {"vertical_viscous": {"damping": 1500.0}, "horizontal_viscous": {"damping": 60.0}}
CANDIDATES = (
    *("cohesion", "vertical_viscous", "horizontal_viscous", "horizontal_coulomb", "drawbar"),
    *("measurement_delay", "surface_slope", "rate_hardening"),
)

PAIRS = SetScreeningSettings().sets_per_round
# Pairs in a round where the number does not matter.
FEW = 3


@pytest.fixture(scope="module")
def regressors(pool) -> Regressors:
    effects = [*map(effect_class, CANDIDATES)]
    dataset = dataset_with(
        *({"name": name} | numbers for name, numbers in TRUTH.items()), settings=WITH_REST
    )
    dataset = replace(dataset, shared=shared_model(effects))
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    return Regressors.of(dataset, linearized, effects, pool)


@pytest.fixture(scope="module")
def singles(regressors, pool):
    found = {}
    for variant in regressors.variants:
        name = variant.effect.about.name
        found[name] = max(
            found.get(name, variant),
            variant,
            key=lambda each: linear_fit_of(regressors, [each]).score,
        )
    alone = [
        refine(regressors, linear_start(regressors, [each]), 4, pool) for each in found.values()
    ]
    return sorted(alone, key=lambda each: -each.score)


@pytest.fixture(scope="module")
def pairs(regressors, singles, pool):
    return refine_sets(regressors, singles, singles, pool)


def test_what_singles_did_alone_puts_the_true_pair_first(regressors, singles, pool):
    assert next(set_candidates(regressors, singles, singles, pool)).names == set(TRUTH)


def test_what_does_most_alone_is_tried_beside_the_best_whatever_linear_fits_say(
    regressors, singles, pool, monkeypatch
):
    """Where the reference model is far off, dozens of effects gain more by a linear fit."""
    refined = set_candidates_module._with_refined  # pyright: ignore[reportPrivateUsage]

    def with_low_scores_for_the_leading(*args):
        return [
            [replace(e, score=-np.inf if leading <= e.names else e.score) for e in by_share]
            for by_share in refined(*args)
        ]

    leading = frozenset(singles[0].names + singles[1].names)
    monkeypatch.setattr(set_candidates_module, "_with_refined", with_low_scores_for_the_leading)
    first = next(set_candidates(regressors, singles, singles, pool))
    assert first.names == leading
    assert first.score == -np.inf


def test_the_way_ahead_of_a_pair_leads_near_both_truths(regressors, singles, pool):
    pair = next(set_candidates(regressors, singles, singles, pool)).build()
    assert not pair.is_simulated
    assert pair.proposed_step is not None
    there = pair.coordinates + pair.proposed_step[1]
    for free, coordinate in zip(pair.model.free, there, strict=True):
        (true,) = TRUTH[pair.model.names[free.index]].values()
        assert free.value(coordinate) == pytest.approx(true, rel=START)


def test_the_true_pair_is_settled_to_the_noise_and_beats_all_others(pairs):
    assert len({frozenset(each.names) for each in pairs}) == len(pairs) == PAIRS
    best = max(pairs, key=lambda each: each.score)
    assert set(best.names) == set(TRUTH)
    for free, coordinate in zip(best.model.free, best.coordinates, strict=True):
        (true,) = TRUTH[best.model.names[free.index]].values()
        assert free.value(coordinate) == pytest.approx(true, rel=TOLD)
    for residual in best.residual:
        assert np.sqrt(np.mean(residual**2)) < LEFT


def test_a_shape_found_alone_goes_into_the_pair(regressors, singles, pool):
    hardening = next(each for each in singles if each.names == ("rate_hardening",))
    pairs = [
        each.build()
        for each in set_candidates(regressors, singles, singles, pool)
        if each.names == {"rate_hardening", singles[0].names[0]}
    ]
    shape = next(k for k, free in enumerate(pairs[0].model.free) if free.scale is None)
    assert any(pair.coordinates[shape] in hardening.coordinates for pair in pairs)


@pytest.mark.parametrize("most", [1, 2])
def test_no_effect_is_added_too_often_before_others(regressors, singles, pool, monkeypatch, most):
    """Bases that look alike would fill a round with the same few effects beside each of them."""
    begun = []

    def as_they_begin(regressors, starts, pool, settings, refinement):
        begun.extend(starts)
        return list(starts)

    monkeypatch.setattr(set_screening, "race", as_they_begin)
    every = SetScreeningSettings(
        max_per_effect=most,
        max_correlated=10**6,
        sets_per_round=10**6,
        both_starts=0,
        max_retries=0,
    )
    refine_sets(regressors, singles, singles, pool, every)
    # The effect that is added comes last.
    added = [each.names[-1] for each in begun]
    early = len(added) - sum(max(added.count(name) - most, 0) for name in {*added})
    assert most <= max(added.count(name) for name in added)
    assert all(added[:early].count(name) <= most for name in added)
    by_set = [frozenset(each.names) for each in begun]
    begun.clear()
    refine_sets(regressors, singles, singles, pool, replace(every, max_per_effect=10**6))
    as_ranked = [frozenset(each.names) for each in begun]
    assert by_set != as_ranked
    assert {*by_set} == {*as_ranked}


def test_of_what_changes_the_runs_alike_few_come_before_others(
    regressors, singles, pool, monkeypatch
):
    """A pull and friction do the same to a wheel that only goes forward."""
    begun = []

    def as_they_begin(regressors, starts, pool, settings, refinement):
        begun.append([each.names[-1] for each in starts])
        return list(starts)

    monkeypatch.setattr(set_screening, "race", as_they_begin)
    base = [each for each in singles if each.names == ("vertical_viscous",)]
    for most in (1, 10**6):
        every = SetScreeningSettings(
            max_correlated=most, sets_per_round=10**6, both_starts=0, max_retries=0
        )
        refine_sets(regressors, base, singles, pool, every)
    one_first, as_ranked = begun
    assert {*one_first} == {*as_ranked}
    second = max(("drawbar", "horizontal_coulomb"), key=as_ranked.index)
    assert as_ranked[-1] != second
    assert one_first == [*(name for name in as_ranked if name != second), second]


def test_an_effect_that_has_no_part_is_taken_out_again(regressors, singles, pairs, pool):
    """The true pair with a third effect, without it, is the true pair."""
    pair = max(pairs, key=lambda each: each.score)
    bases = [pair]
    with_third = refine_sets(regressors, bases, singles, pool, DEFAULT_LARGER_SETS)[0]
    assert set(with_third.names) > set(TRUTH)
    assert with_third.score < pair.score + THIRD_GAINS
    place = next(k for k, name in enumerate(with_third.names) if name not in TRUTH)
    left = refine(regressors, without_effect(with_third, place), 3, pool)
    assert set(left.names) == set(TRUTH)
    assert left.score == pytest.approx(pair.score, abs=THIRD_GAINS)


def test_a_set_begins_with_the_simpler_form_of_an_effect_unless_the_other_gains(regressors):
    of = {each.effect.about.name: each for each in regressors.variants}
    simple = linear_start(regressors, [of["vertical_viscous"]])
    other = replace(
        linear_start(regressors, [of["horizontal_viscous"]]), coordinates=np.zeros(3)
    )  # stands for a form of two numbers more
    form = replace(other, model=simple.model)

    def first(gain: float) -> int:
        by_score = [
            replace(form, fit=replace(form.fit, score=100.0 + gain)),
            replace(simple, fit=replace(simple.fit, score=100.0)),
        ]
        (found,) = leading_bases(by_score, SetScreeningSettings())
        return len(found.coordinates)

    cost = 2 * SetScreeningSettings().number_cost
    assert first(0.2) == len(simple.coordinates)
    assert first(cost - 0.1) == len(simple.coordinates)
    assert first(cost + 0.1) == 3


def test_a_base_too_far_behind_begins_no_set(regressors):
    of = {each.effect.about.name: each for each in regressors.variants}
    names = ("vertical_viscous", "horizontal_viscous")
    near, far = (linear_start(regressors, [of[name]]) for name in names)
    limits = SetScreeningSettings(max_deficit=10.0)
    for behind, count in ((9.0, 2), (11.0, 1)):
        scores = (0.0, -behind)
        bases = [
            replace(each, fit=replace(each.fit, score=score))
            for each, score in zip((near, far), scores, strict=True)
        ]
        assert len(leading_bases(bases, limits)) == count


def test_a_set_without_its_step_is_the_base(regressors, pool):
    """An effect at its null changes nothing: what goes astray from there has a way back."""
    of = {each.effect.about.name: each for each in regressors.variants}
    base = refine(regressors, linear_start(regressors, [of["vertical_viscous"]]), 2, pool)
    candidate = next(set_candidates(regressors, [base], [], pool, SetScreeningSettings()))
    start = candidate.build()
    assert start.start_score == candidate.base.score == base.score
    back = at_its_start(regressors, start, pool)
    assert back.is_simulated
    assert back.proposed_step is None
    assert back.score == pytest.approx(base.score, rel=1e-9)  # the same residuals, summed again


def test_where_the_model_is_far_off_all_pairs_begin_from_both_kinds_of_start(
    regressors, singles, pool, monkeypatch
):
    begun = []

    def as_they_begin(regressors, starts, pool, settings, refinement):
        begun.append(starts)
        return [replace(each, is_simulated=True) for each in starts]

    monkeypatch.setattr(set_screening, "race", as_they_begin)
    # Every effect was simulated alone, so that all pairs have both kinds.
    settings = replace(DEFAULT_PAIRS.where(is_far=True), sets_per_round=FEW, max_retries=0)
    refine_sets(regressors, singles, singles, pool, settings)
    first, other = begun
    assert [frozenset(each.names) for each in other] == [
        frozenset(each.names) for each in sorted(first, key=lambda each: -each.score)
    ]
    for each, mine in itertools.product(first, other):
        if set(each.names) == set(mine.names):
            assert not np.array_equal(each.proposed_step[1], mine.proposed_step[1])
    assert DEFAULT_PAIRS.where(is_far=False).both_starts < settings.both_starts


@pytest.mark.parametrize("is_far", [True, False])
def test_pairs_get_derivatives_by_the_simulator_far_from_the_model_alone(
    regressors, singles, pool, monkeypatch, is_far
):
    computed = []

    def counted(regressors, here, pool):
        computed.append(here.names)
        return relinearize(regressors, here, pool)

    monkeypatch.setattr(set_screening, "relinearize", counted)
    start = next(set_candidates(regressors, singles, singles, pool)).build()
    (found,) = race(regressors, [start], pool, DEFAULT_PAIRS.where(is_far), DEFAULT_REFINEMENT)
    assert found.is_simulated
    assert computed == [start.names] * is_far
    assert not DEFAULT_LARGER_SETS.where(is_far).fresh_derivatives


def test_a_start_that_goes_far_to_where_it_does_worse_is_gone_on_from(regressors, singles, pool):
    start = next(set_candidates(regressors, singles, singles, pool)).build()
    zeta, coordinates = start.proposed_step
    # A tenth of zeta more: twice what counts as far.
    far = replace(start, proposed_step=(zeta + 2 * DEFAULT_REFINEMENT.min_detour, coordinates))
    promised = replace(far, fit=replace(far.fit, score=1e6))
    settings = replace(DEFAULT_LARGER_SETS, max_continued=1, max_astray=1)

    def raced(*starts):
        others = race(regressors, starts, pool, settings, DEFAULT_REFINEMENT)
        return min(each.score for each in others), max(each.score for each in others)

    worst, best = raced(start, far)  # no linear fit puts it first
    assert worst < start.start_score < best
    worst, best = raced(start, promised)
    assert worst > start.start_score


def test_no_start_is_refined_twice(regressors, singles, pool, monkeypatch):
    """A refinement has no chance in it: the same start ends at the same place."""
    begun = []

    def astray(regressors, starts, pool, settings, refinement):
        begun.extend((each.names, each.proposed_step[1].tobytes()) for each in starts)
        return [
            replace(each, fit=replace(each.fit, score=-1e6), is_simulated=True) for each in starts
        ]

    monkeypatch.setattr(set_screening, "race", astray)
    settings = SetScreeningSettings(sets_per_round=FEW, both_starts=FEW, max_retries=FEW)
    refine_sets(regressors, singles, singles, pool, settings)
    assert len(begun) > FEW
    assert len({*begun}) == len(begun)


def test_a_set_that_does_worse_than_a_part_of_it_begins_again_from_there(
    regressors, singles, pool, monkeypatch
):
    begun = []

    def astray_at_first(regressors, starts, pool, settings, refinement):
        begun.append(starts)
        score = -1e6 if len(begun) == 1 else 1e6
        return [
            replace(each, fit=replace(each.fit, score=score), is_simulated=True) for each in starts
        ]

    monkeypatch.setattr(set_screening, "race", astray_at_first)
    settings = SetScreeningSettings(sets_per_round=FEW, both_starts=0, max_retries=1)
    found = refine_sets(regressors, singles, singles, pool, settings)
    first, again = begun
    assert {frozenset(each.names) for each in again} == {frozenset(first[0].names)}
    parts = [each.score for each in singles if set(each.names) < set(again[0].names)]
    assert {each.start_score for each in again} == {max(parts)}
    assert [each.score for each in found] == [1e6, -1e6, -1e6]
    begun.clear()
    refine_sets(regressors, singles, singles, pool, replace(settings, max_retries=0))
    assert len(begun) == 1
