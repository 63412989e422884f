"""Pairs of effects: what each did alone leads to both, however far from the null."""

import numpy as np
import pytest

from diagnose.dataset import match_initial_zeta
from diagnose.hypotheses.hypothesis import linear_fit_of, linear_start, refine
from diagnose.hypotheses.pair_screening import PAIRS, pair_candidates, refine_pairs
from diagnose.linear.regressors import Regressors
from drftjax.effects.catalogue import effect_class
from tests.helpers.rig_datasets import case_with

# A way ahead leads each number to within a tenth, fitted alone to what both did: a start, which
# simulation then settles to what three short runs tell of it, a per cent or two.
START, TOLD = 0.1, 0.03
# The runs' own noise is 20 um, and plates and steps leave a part of it more [m].
LEFT = 30e-6
# A damper, not friction: what friction does a pull does as well on a wheel that only goes forward,
# and its derivative hangs on rounding where the wheel nearly sticks.
TRUTH = {"vertical_viscous": {"damping": 1500.0}, "horizontal_viscous": {"damping": 60.0}}
CANDIDATES = (
    *("cohesion", "vertical_viscous", "horizontal_viscous", "horizontal_coulomb", "drawbar"),
    *("measurement_delay", "surface_slope", "rate_hardening", "bulldozing", "depth_hardening"),
)


@pytest.fixture(scope="module")
def bench() -> Regressors:
    case = case_with(*({"name": name} | numbers for name, numbers in TRUTH.items()))
    return Regressors.of(
        case, match_initial_zeta(case), [effect_class(name) for name in CANDIDATES]
    )


@pytest.fixture(scope="module")
def singles(bench):
    found = {}
    for variant in bench.variants:
        name = variant.effect.about.name
        found[name] = max(
            found.get(name, variant), variant, key=lambda each: linear_fit_of(bench, [each]).score
        )
    alone = [refine(bench, linear_start(bench, [each]), 4) for each in found.values()]
    return sorted(alone, key=lambda each: -each.score)


def test_what_singles_did_alone_puts_the_true_pair_first(bench, singles):
    assert next(pair_candidates(bench, singles)).names == set(TRUTH)


def test_the_way_ahead_of_a_pair_leads_near_both_truths(bench, singles):
    pair = next(pair_candidates(bench, singles)).build()
    assert not pair.is_simulated
    assert pair.proposed_step is not None
    there = pair.coordinates + pair.proposed_step[1]
    for free, coordinate in zip(pair.model.free, there, strict=True):
        (true,) = TRUTH[pair.model.names[free.index]].values()
        assert free.value(coordinate) == pytest.approx(true, rel=START)


def test_the_true_pair_is_settled_to_the_noise_and_beats_all_others(bench, singles):
    pairs = refine_pairs(bench, singles)
    assert len({frozenset(each.names) for each in pairs}) == len(pairs) == PAIRS
    best = max(pairs, key=lambda each: each.score)
    assert set(best.names) == set(TRUTH)
    for free, coordinate in zip(best.model.free, best.coordinates, strict=True):
        (true,) = TRUTH[best.model.names[free.index]].values()
        assert free.value(coordinate) == pytest.approx(true, rel=TOLD)
    for residual in best.residual:
        assert np.sqrt(np.mean(residual**2)) < LEFT


def test_a_shape_found_alone_goes_into_the_pair(bench, singles):
    hardening = next(each for each in singles if each.names == ("rate_hardening",))
    pairs = [
        each.build()
        for each in pair_candidates(bench, singles)
        if each.names == {"rate_hardening", singles[0].names[0]}
    ]
    shape = next(k for k, free in enumerate(pairs[0].model.free) if free.scale is None)
    assert any(pair.coordinates[shape] in hardening.coordinates for pair in pairs)


def test_while_the_best_pair_is_far_off_as_many_more_are_tried(bench, singles, monkeypatch):
    def with_the_truth_late(bench, singles):
        all_of_them = list(pair_candidates(bench, singles))
        others = dict.fromkeys(each.names for each in all_of_them if each.names != set(TRUTH))
        order = [*list(others)[:PAIRS], frozenset(TRUTH), *list(others)[PAIRS:]]
        return sorted(all_of_them, key=lambda each: order.index(each.names))

    monkeypatch.setattr("diagnose.hypotheses.pair_screening.pair_candidates", with_the_truth_late)
    monkeypatch.setattr("diagnose.hypotheses.pair_screening.FAR", np.inf)
    near = refine_pairs(bench, singles)
    assert len(near) == PAIRS
    assert set(TRUTH) not in [set(each.names) for each in near]
    monkeypatch.setattr("diagnose.hypotheses.pair_screening.FAR", 1.5)
    far = refine_pairs(bench, singles)
    assert len(far) == 2 * PAIRS
    assert set(far[0].names) == set(TRUTH)
