"""Two effects at once: those that cancel each other are found by neither alone."""

from collections import Counter

import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses.hypothesis import linear_fit_of, linear_start
from diagnose.hypotheses.joint_additions import JointSettings, joint_starts
from diagnose.hypotheses.refinement import refine
from diagnose.hypotheses.screening import screen_effects
from diagnose.linear.linear_fit import WITHOUT_LEVELS
from diagnose.linear.linearized_runs import linearize_runs
from diagnose.linear.regressors import Regressors
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import dataset_with

# A spring holds the carriage up by what sand that sinks with slip lets it down.
TRUTH = {"slip_sinkage": {"rate": 4.0}, "vertical_spring": {"stiffness": 12e3}}
OTHERS = ("depth_power", "depth_hardening", "wheel_radius", "sinkage_gain", "heap", "drawbar")

# Three short runs say less than the nine long ones for which the default is.
SETTINGS = JointSettings(min_gain=3.0)


@pytest.fixture(scope="module")
def regressors(pool) -> Regressors:
    dataset = dataset_with(*({"name": name} | numbers for name, numbers in TRUTH.items()))
    linearized = linearize_runs(dataset, match_initial_zeta(dataset, pool), pool)
    effects = [effect_class(name) for name in (*TRUTH, *OTHERS)]
    # Levels hold the zetas of the reference model, from where these two are too strong for linear
    # fits; a search by simulation finds them with levels, too (below).
    return Regressors.of(dataset, linearized, effects, pool, WITHOUT_LEVELS)


@pytest.fixture(scope="module")
def none(regressors, pool):
    return refine(regressors, linear_start(regressors, []), 3, pool)


def test_effects_that_cancel_each_other_lead_together_though_not_alone(regressors, none, pool):
    alone: dict[str, float] = {}
    for variant in regressors.variants:
        name, score = variant.effect.about.name, linear_fit_of(regressors, [variant]).score
        alone[name] = max(score, alone.get(name, score))
    leading = sorted(alone, key=lambda name: -alone[name])
    assert not set(TRUTH) & set(leading[:2])
    starts = joint_starts(regressors, [none], [], pool, SETTINGS)
    assert set(starts[0].names) == set(TRUTH)
    refined = refine(regressors, starts[0], 3, pool)
    assert refined.score > none.score + SETTINGS.min_gain


def test_a_search_finds_two_that_cancel_each_other_though_others_lead_alone(pool):
    dataset = dataset_with(*({"name": name} | numbers for name, numbers in TRUTH.items()))
    found = screen_effects(dataset, [effect_class(name) for name in (*TRUTH, *OTHERS)], pool)
    assert not set(TRUTH) & {name for each in found.singles[:2] for name in each.names}
    assert set(found.pairs[0].names) == set(TRUTH)
    # Far more than what two numbers cost.
    assert found.pairs[0].score > found.singles[0].score + 20


def test_sets_that_are_known_or_add_one_effect_too_often_are_not_begun(regressors, none, pool):
    starts = joint_starts(regressors, [none], [], pool, SETTINGS)
    again = joint_starts(regressors, [none], [starts[0]], pool, SETTINGS)
    assert frozenset(starts[0].names) not in {frozenset(each.names) for each in again}
    count = Counter(name for each in again for name in each.names)
    assert max(count.values()) <= SETTINGS.max_per_effect


def test_pairs_that_gain_too_little_beyond_the_better_one_are_not_begun(regressors, none, pool):
    assert joint_starts(regressors, [none], [], pool, JointSettings(min_gain=1e3)) == []
