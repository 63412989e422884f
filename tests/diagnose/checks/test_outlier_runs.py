"""Runs that do not go with the others: what repeats call chance, and what is told of odd ones."""

import copy
import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnose.checks.outlier_runs import (
    DEFAULT_OUTLIER_RUNS,
    OutlierRunSettings,
    gap_carried_by_one_run,
    outliers_among_repeats,
    outliers_by_zeta,
)
from diagnose.dataset import RigDataset
from diagnose.gap.repeatability import repeat_variance, repeats
from diagnose.linear.linear_fit import block_names
from diagnose.localization.shares import GapShare
from diagnose.selection.model_weights import (
    NONE,
    UNKNOWN,
    LeftByRun,
    ScoredHypothesis,
    weights,
)
from tests.helpers.rig_datasets import dataset_with

# Rounding of squares of misses of a millimetre.
ROUNDING = 1e-20
# A tenth for all else together, which is no close call; and no doubt at all.
LIKELY, SURE = 0.9, 0.99
NOISE = {"x": 1e-6, "z": 1e-6}


@pytest.fixture(scope="module")
def case() -> RigDataset:
    """Three runs, of which the first two repeat each other."""
    return dataset_with()


def alike(run: int) -> np.ndarray:
    raise AssertionError(f"run {run} was recorded as long as its repeat")


def misses(case: RigDataset, **by_run: float) -> list[np.ndarray]:
    """Residuals that are a constant in z for some runs, zero in all else."""
    found = [np.zeros((2, len(case.time(run)))) for run in range(len(case.runs))]
    for name, size in by_run.items():
        found["abc".index(name)][case.channels.index("z")] = size
    return found


def test_half_the_power_of_what_repeats_differ_by_is_chance(case):
    assert repeats(case, "z") == [(0, 1)]
    found = dict(
        zip(
            block_names(case.channels),
            repeat_variance(case, [misses(case, b=1e-3)], alike),
            strict=True,
        )
    )
    assert found.pop(("z", "slow")) == pytest.approx(0.5e-6)
    assert found.pop(("z", "level")) == pytest.approx(0.5e-6)
    # A constant has no fast part, but for rounding.
    assert max(found.values()) < ROUNDING


def test_what_a_model_explains_of_two_repeats_is_no_chance(case):
    told = repeat_variance(case, [misses(case, b=1e-3), misses(case, a=2e-3, b=2e-3)], alike)
    assert told.max() < ROUNDING


def test_runs_that_begin_elsewhere_do_not_tell_chance(case):
    for field, much in (("x", 0.05), ("angle", 0.2)):
        moved = copy.deepcopy(case.runs[1].setup)
        setattr(moved.start, field, getattr(moved.start, field) + much)
        runs = list(case.runs)
        runs[1] = dataclasses.replace(runs[1], setup=moved)
        alone = RigDataset.of(runs)
        assert repeats(alone, "z") == []
        assert not repeat_variance(alone, [misses(alone, b=1e-3)], alike).any()
    turned = copy.deepcopy(case.runs[1].setup)
    turned.start.angle += 2 * np.pi
    runs[1] = dataclasses.replace(case.runs[1], setup=turned)
    assert repeats(RigDataset.of(runs), "z") == [(0, 1)]


def test_runs_that_begin_alike_repeat_each_other_whatever_comes_between(case):
    other = copy.deepcopy(case.runs[0].setup)
    other.start.angle += 0.2
    named = [dataclasses.replace(case.runs[0], name=name) for name in "abc"]
    named[1] = dataclasses.replace(named[1], setup=other)
    assert repeats(RigDataset.of(named), "z") == [(0, 2)]
    assert repeats(RigDataset.of(named), "z", from_one_start=False) == [(0, 1), (0, 2), (1, 2)]


def test_what_repeats_differ_by_is_nothing_for_unknown_to_explain():
    number, noise = np.array([400.0]), np.array([1e-12])
    judged = [ScoredHypothesis((), 0, LeftByRun(np.array([[1e-6]]), np.zeros(1)))]

    def of(by_chance: float) -> dict:
        return weights(judged, (("z", "slow"),), number, noise, repeat_power=np.array([by_chance]))

    assert of(0.0)[(UNKNOWN,)] > SURE
    assert of(1e-12) == of(0.0)  # within noise and a model's own error
    assert of(1e-6)[(NONE,)] > LIKELY


def test_repeats_that_disagree_are_named(case):
    (told,) = outliers_among_repeats(
        case, [misses(case, b=1e-3), misses(case, b=0.5e-3)], NOISE, alike
    )
    assert told.startswith("run 0 and run 1 repeat each other and differ by 0.5 mm in z, ")
    # The same gap in both is an effect's.
    assert outliers_among_repeats(case, [misses(case, a=1e-3, b=1.2e-3)], NOISE, alike) == []
    assert outliers_among_repeats(case, [misses(case, b=1e-6)], NOISE, alike) == []


def test_a_zeta_far_from_all_others_is_named(case):
    candidates = [dataclasses.replace(case.runs[0], name=f"run {number}") for number in range(6)]
    columns = [np.full((2, 3, 1), 0.02)] * 6
    bench: Any = SimpleNamespace(
        dataset=SimpleNamespace(runs=candidates, channels=("x", "z")),
        log_reference_zeta=np.zeros(6),
    )

    def of(*zetas: float) -> list[str]:
        chosen: Any = SimpleNamespace(log_zeta=np.log(zetas), columns=columns)
        return outliers_by_zeta(bench, chosen)

    (told,) = of(0.75, 0.76, 0.755, 0.68, 0.752, 0.758)
    assert told.startswith("The zeta of run 3 is 0.68, of the others 0.75 to 0.76")
    # 20 mm of sinkage by a logarithm, of 0.75 / 0.68.
    assert "by about 2 mm" in told
    assert of(0.75, 0.76, 0.755, 0.73, 0.752, 0.758) == []  # three per cent
    assert of(0.75, 0.80, 0.70, 0.66, 0.78, 0.72) == []  # all scatter
    assert of(0.75, 0.76, 0.755, 0.68, 0.752, 0.68) == []  # two alike: a load, or an effect


def test_a_run_that_holds_most_of_the_gap_is_named(case):
    candidates = [dataclasses.replace(case.runs[0], name=f"run {number}") for number in range(5)]
    several: Any = SimpleNamespace(runs=candidates, channels=("z", "torque"))
    # No other run has torque.
    before = [np.array([[2e-5] * 10, [np.nan] * 10])] * 4 + [np.full((2, 10), 1e-3)]

    def of(share: float, time: float, settings: OutlierRunSettings = DEFAULT_OUTLIER_RUNS):
        rest = [GapShare("run", f"run {n}", (1 - share) / 4, (0.0, 1.0), 0.2) for n in range(4)]
        last = GapShare("run", "run 4", share, (0.0, 1.0), time)
        floors = {"z": 2e-5, "torque": 0.1}
        return gap_carried_by_one_run(several, [*rest, last], before, floors, settings)

    (told,) = of(0.9, 0.2)
    assert told.startswith("run 4 holds 90% of the gap in 20% of the time")
    assert "1.0 noise floors in z. Look" in told
    assert of(0.45, 0.1) == []
    assert of(0.9, 0.4) == []
    assert of(0.45, 0.1, OutlierRunSettings(run_share=0.4)) != []
