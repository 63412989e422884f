"""Look-alikes of a set's effects: found by what they change, and tried in the effects' places."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses.exchange import ExchangeSettings, doubly_exchanged, exchanged_sets
from diagnose.hypotheses.hypothesis import Hypothesis, best_of_each, linear_start
from diagnose.hypotheses.refinement import refine, relinearize
from diagnose.hypotheses.screening import Screening, ScreeningResult
from diagnose.hypotheses.set_candidates import DEFAULT_LARGER_SETS
from diagnose.hypotheses.settings import DEFAULT_SCREENING
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from diagnose.model.augmented_model import AugmentedModel, shared_model
from drftjax.effects.catalogue import effect_class, reported_name
from tests.helpers.rig_datasets import WITH_REST, dataset_with

# On a wheel that only goes forward a pull and friction are one, and a lag of the drive is nearly
# one of the instruments; a rise of the ground is none of these.
CANDIDATES = (
    "horizontal_coulomb",
    "speed_lag",
    "drawbar",
    "measurement_filter",
    "surface_slope",
    "grouser_height",
)
TRUTH = (
    {"name": "horizontal_coulomb", "force": 6.0},
    {"name": "speed_lag", "lag": 0.15},
)


def regressors_with(truth, pool, candidates=CANDIDATES) -> Regressors:
    effects = [*map(effect_class, candidates)]
    dataset = replace(dataset_with(*truth, settings=WITH_REST), shared=shared_model(effects))
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    return Regressors.of(dataset, linearized, effects, pool)


@pytest.fixture(scope="module")
def regressors(pool) -> Regressors:
    return regressors_with(TRUTH, pool)


@pytest.fixture(scope="module")
def wrong(regressors, pool):
    """The pair with each effect's look-alike in its place."""
    of = {each.effect.about.name: each for each in regressors.variants}
    start = linear_start(regressors, [of["drawbar"], of["measurement_filter"]])
    return refine(
        regressors, relinearize(regressors, refine(regressors, start, 2, pool), pool), 3, pool
    )


def names_in_place(regressors, best, place, pool) -> list[str]:
    """Names of what is tried in the place of one effect of a pair, in the order of the ranking."""
    kept = {best.names[1 - place]}
    by_place = exchanged_sets(regressors, best, [], pool)
    return [name for each in by_place[place] for name in each.names if name not in kept]


def test_friction_is_the_look_alike_of_a_pull(regressors, wrong, pool):
    assert names_in_place(regressors, wrong, 0, pool)[0] == "horizontal_coulomb"


def test_beside_a_large_lag_a_pull_is_still_the_look_alike_of_friction(pool):
    regressors = regressors_with((TRUTH[0], {"name": "speed_lag", "lag": 0.4}), pool)
    of = {each.effect.about.name: each for each in regressors.variants}
    start = linear_start(regressors, [of["horizontal_coulomb"], of["speed_lag"]])
    pair = relinearize(regressors, refine(regressors, start, 2, pool), pool)
    pair = relinearize(regressors, refine(regressors, pair, 3, pool), pool)
    # On a wheel that goes forward they are one. By responses about the reference model alone a rise
    # of the ground leads.
    assert names_in_place(regressors, pair, 0, pool)[0] == "drawbar"


def test_forms_of_one_effect_take_one_place_of_the_three_that_are_tried_in_any_case(pool):
    regressors = regressors_with(TRUTH, pool, (*CANDIDATES, "surface_incline"))
    of = {each.effect.about.name: each for each in regressors.variants}
    start = linear_start(regressors, [of["drawbar"], of["speed_lag"]])
    pair = relinearize(regressors, refine(regressors, start, 2, pool), pool)
    for place in (0, 1):
        tried = [reported_name(name) for name in names_in_place(regressors, pair, place, pool)]
        assert len(tried) == len(set(tried)) >= ExchangeSettings().min_alike


def test_two_look_alikes_are_exchanged_at_once_where_each_alone_is_nearly_as_good(
    regressors, wrong, pool
):
    of = {each.effect.about.name: each for each in regressors.variants}

    def pair(*names: str) -> Hypothesis:
        begun = refine(regressors, linear_start(regressors, [of[n] for n in names]), 2, pool)
        return refine(regressors, relinearize(regressors, begun, pool), 3, pool)

    one = pair("horizontal_coulomb", "measurement_filter")
    same_place = pair("surface_slope", "measurement_filter")
    other = pair("drawbar", "speed_lag")
    near = replace(ExchangeSettings(), max_deficit_alone=np.inf)
    (both,) = doubly_exchanged(wrong, [one, other], near)
    assert set(both.names) == {"horizontal_coulomb", "speed_lag"}
    assert doubly_exchanged(wrong, [one, same_place], near) == []
    assert doubly_exchanged(wrong, [one, other, both], near) == []
    assert doubly_exchanged(wrong, [one, other], replace(near, max_doubly_exchanged=0)) == []
    far = min(one.score, other.score) - 1
    behind = replace(wrong, fit=replace(wrong.fit, score=far + 2 + 10.0))
    assert doubly_exchanged(behind, [one, other], replace(near, max_deficit_alone=10.0)) == []
    # What both change adds up, and leads to the truth. A pull does as well as friction here.
    started = refine(regressors, both, 1, pool)
    found = refine(regressors, relinearize(regressors, started, pool), 4, pool)
    assert found.score == pytest.approx(max(one.score, other.score), abs=0.1)
    lag = next(k for k, free in enumerate(found.model.free) if free.field == "lag")
    assert found.model.free[lag].value(found.coordinates[lag]) == pytest.approx(0.15, rel=0.1)


def test_a_sum_of_waves_is_tried_in_the_place_of_one_wave(pool):
    waves = {
        "name": "terrain_waves",
        "first_cosine": 0.06,
        "first_sine": 0.05,
        "first_length": 0.30,
        "second_sine": 0.05,
        "second_length": 0.13,
    }
    candidates = ("horizontal_coulomb", "terrain_variation", "terrain_wave")
    regressors = regressors_with((TRUTH[0], waves), pool, candidates)
    of = {each.effect.about.name: each for each in regressors.variants}
    start = linear_start(regressors, [of["horizontal_coulomb"], of["terrain_wave"]])
    pair = refine(
        regressors, relinearize(regressors, refine(regressors, start, 3, pool), pool), 5, pool
    )
    (summed,) = (
        each
        for each in exchanged_sets(regressors, pair, [], pool)[1]
        if "terrain_waves" in each.names
    )
    assert "terrain_waves" not in {
        name
        for tried in exchanged_sets(regressors, pair, [], pool, with_sums=False)
        for each in tried
        for name in each.names
    }
    found = refine(regressors, summed, 1, pool)
    found = refine(regressors, relinearize(regressors, found, pool), 5, pool)
    assert found.score > pair.score + DEFAULT_SCREENING.min_set_gain
    lengths = [
        each.value(at)
        for each, at in zip(found.model.free, found.coordinates, strict=True)
        if each.field.endswith("length")
    ]
    # A third wave has nothing to do, or stands beside one of the others: a tenth.
    assert min(abs(each / 0.30 - 1) for each in lengths) < 0.1
    assert min(abs(each / 0.13 - 1) for each in lengths) < 0.1


def test_a_look_alike_leads_to_the_true_lag(regressors, wrong, pool):
    by_place = exchanged_sets(regressors, wrong, [wrong], pool)
    found = [each for alike in by_place for each in alike]
    assert all(len(each.names) == 2 and each.proposed_step is not None for each in found)
    assert all(len(set(each.names) & set(wrong.names)) == 1 for each in found)
    lag = next(each for each in found if each.names == ("drawbar", "speed_lag"))
    assert lag.proposed_step is not None
    # It begins where it does what the filter did, not at its null.
    assert lag.model.free[1].value(lag.proposed_step[1][1]) == pytest.approx(0.15, rel=0.3)
    moved = refine(regressors, lag, 3, pool)
    exact = refine(regressors, relinearize(regressors, moved, pool), 3, pool)
    assert exact.score > wrong.score
    assert exact.model.free[1].field == "lag"
    # A pull stands for friction, which three short runs hardly tell apart: a tenth.
    assert exact.model.free[1].value(exact.coordinates[1]) == pytest.approx(0.15, rel=0.1)


@pytest.fixture(scope="module")
def settled(regressors, pool):
    """Refine a set of effects to its end, each set once."""
    of = {each.effect.about.name: each for each in regressors.variants}

    @cache
    def refined(*names: str) -> Hypothesis:
        start = refine(regressors, linear_start(regressors, [of[name] for name in names]), 2, pool)
        return refine(regressors, relinearize(regressors, start, pool), 3, pool)

    return refined


def test_look_alikes_are_tried_in_the_part_of_a_set_that_does_as_well(regressors, settled, pool):
    # The ground does not rise: the pair without it, which nobody has tried, is the one to tell.
    pair, three = (
        settled("drawbar", "surface_slope"),
        settled("drawbar", "speed_lag", "surface_slope"),
    )
    by_size = [[settled("drawbar")], [pair], [three]]
    Screening(regressors, pool).exchange_effects(by_size, DEFAULT_LARGER_SETS, lambda stage: None)
    tried = {frozenset(each.names) for each in by_size[1]}
    assert {"drawbar", "speed_lag"} in tried
    assert {"horizontal_coulomb", "speed_lag"} in tried


def test_a_part_of_a_set_that_went_astray_on_its_way_is_tried_again(regressors, settled, pool):
    pair, three = (
        settled("drawbar", "speed_lag"),
        settled("drawbar", "speed_lag", "surface_slope"),
    )
    astray = replace(pair, fit=replace(pair.fit, score=three.score - 1000))
    by_size = [[settled("drawbar")], [astray], [three]]
    Screening(regressors, pool).take_out(by_size, 2)
    found = {frozenset(each.names): each.score for each in by_size[1]}
    # The ground does not rise.
    assert found[frozenset(pair.names)] > three.score - DEFAULT_SCREENING.min_set_gain


def test_a_single_effect_that_stopped_short_is_tried_again_from_the_pair(regressors, settled, pool):
    lag, pair = settled("speed_lag"), settled("drawbar", "speed_lag")
    # Behind, but not so far that it would count as astray.
    short = replace(lag, fit=replace(lag.fit, score=lag.score - 20))
    by_size = [[short], [pair]]
    Screening(regressors, pool).take_out_further(by_size)
    found = {each.names: each.score for each in by_size[0]}
    assert found["speed_lag",] == pytest.approx(lag.score, abs=1.0)


def test_the_set_that_is_told_has_its_rivals_whichever_set_was_exchanged(regressors, settled, pool):
    told, none = settled("drawbar", "speed_lag"), linear_start(regressors, [])
    names = frozenset(told.names)
    found = ScreeningResult(regressors, none, (), (told,))
    rivals = Screening(regressors, pool).rivals(found, told, [told])
    assert all(len(names.intersection(each.names)) == 1 for each in rivals)
    best = {frozenset(each.names): each.score for each in rivals}
    # On a wheel that goes forward alone they are one, but for the first instants.
    friction = best[frozenset({"horizontal_coulomb", "speed_lag"})]
    assert friction == pytest.approx(told.score, abs=0.1)
    assert min(best.values()) > told.score - DEFAULT_SCREENING.min_set_gain
    # They are weighed once, and looked for once.
    again = replace(found, exchanged=frozenset({names}), pairs=(told, *rivals))
    assert Screening(regressors, pool).rivals(again, told, [told, *rivals]) == []
    known = Screening(regressors, pool).rivals(again, told, [told])
    assert {frozenset(each.names) for each in known} == set(best)


def test_sets_that_do_about_as_well_are_not_begun_again(regressors, wrong, pool):
    known = replace(
        wrong,
        model=AugmentedModel((effect_class("drawbar"), effect_class("speed_lag"))),
        fit=replace(wrong.fit, score=wrong.score - 1),
    )
    far_behind = replace(known, fit=replace(wrong.fit, score=wrong.score - 1000))
    for others, begun in (([known], False), ([far_behind], True), ([], True)):
        by_place = exchanged_sets(regressors, wrong, others, pool)
        assert (("drawbar", "speed_lag") in [e.names for a in by_place for e in a]) == begun


def test_a_set_that_was_found_twice_is_weighed_once(wrong):
    better = replace(
        wrong,
        model=AugmentedModel(wrong.model.effects[::-1]),
        fit=replace(wrong.fit, score=wrong.score + 1),
    )
    alone = replace(wrong, model=AugmentedModel(wrong.model.effects[:1]))
    assert best_of_each([wrong, better, alone]) == [better, alone]
