"""Exact relabelling: its p against counts by hand, and its level where nothing changed."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.change.differences.conditions import MatchedCondition
from diagnose.change.differences.gram import Differences
from diagnose.change.relabelling import RelabellingSettings, relabelling_test

TIME = np.arange(0, 4, 0.1)
# Of 150 tests at 5 % three standard deviations more.
LEVEL = 0.05 + 3 * np.sqrt(0.05 * 0.95 / 150)


def pairs(count: int) -> Differences:
    """One run before and one now of each of several conditions."""
    conditions = [MatchedCondition((2 * c,), (2 * c + 1,)) for c in range(count)]
    return of(conditions)


def of(conditions: list[MatchedCondition]) -> Differences:
    runs = sum(len(each.runs) for each in conditions)
    dataset = SimpleNamespace(channels=("z",), runs=[None] * runs, time=lambda run: TIME)
    return Differences.of(dataset, conditions)  # pyright: ignore[reportArgumentType]


def levels(values) -> list[np.ndarray]:
    """Runs that read one level each."""
    return [np.full((1, len(TIME)), each) for each in values]


def test_five_pairs_that_all_moved_one_way_give_the_least_p():
    found = relabelling_test(pairs(5), levels([0, 1, 0, 1.2, 0, 0.9, 0, 1.1, 0, 1]))
    assert found.orders == 32
    # All labels the other way round differ as much.
    assert found.p == found.least_p == pytest.approx(2 / 32)


def test_p_is_the_share_of_sign_flips_that_sum_to_as_much():
    changes = np.array([1.0, 0.5, -0.4, 0.2])
    found = relabelling_test(pairs(4), levels(np.stack([0 * changes, changes], axis=1).ravel()))
    signs = np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1)
    sums = np.abs(changes @ signs)
    assert found.p == pytest.approx((sums >= abs(changes.sum()) - 1e-12).mean())


def test_repeats_add_orders():
    found = relabelling_test(
        of([MatchedCondition((0, 1), (2, 3)), MatchedCondition((4,), (5,))]),
        levels([0.0, 0.1, 1.0, 1.1, 0.0, 1.0]),
    )
    assert found.orders == 6 * 2
    assert found.p == pytest.approx(2 / 12)


def test_many_orders_are_drawn():
    few = RelabellingSettings(max_orders=200)
    found = relabelling_test(pairs(12), levels([0, 1] * 12), few)
    assert found.orders == 200
    assert found.p == pytest.approx(1 / 200, abs=2 / 200)


def test_chance_alone_seldom_gives_a_small_p():
    random = np.random.default_rng(0)
    found = [relabelling_test(pairs(6), levels(random.normal(size=12))).p for _ in range(150)]
    assert np.mean(np.array(found) <= 0.05) <= LEVEL
    assert np.mean(found) == pytest.approx(0.5, abs=0.1)
