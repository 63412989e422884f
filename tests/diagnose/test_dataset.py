"""The runs of one rig made ready: programs that are compiled once."""

import dataclasses

import jax
import numpy as np
import pytest

from diagnose.dataset import (
    DatasetSettings,
    InitialZetaSettings,
    RigDataset,
    _early_samples,
    decimate,
)
from diagnose.model.augmented_model import MAX_COVERED_SHARE, AugmentedModel, predict
from diagnose.setting_off import from_setting_off
from drftjax.effects.catalogue import effect_class
from drftjax.recorded.observation import white_noise
from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.setups.setup import WheelSetUp
from tests.helpers.rig_datasets import dataset_with
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# A sum over plates of which some carry nothing, in another order, over a run at 0.5 rad/s [m]. At
# 0.9 rad/s plates of 10 mm have amplified that to 37 um by the end, which is no plate's part.
ROUNDING = 1e-9
SLOW_RUNS = (0, 1)


def logged(rate: float) -> PreparedRun:
    setup = setup_of()
    setup.integrator.step = 1e-3  # rows of any of the rates
    return coarse("fast", recorded(setup, rate=rate))


@pytest.mark.parametrize(("rate", "kept"), [(100.0, 1), (150.0, 1), (200.0, 2), (1000.0, 10)])
def test_a_run_that_was_logged_fast_counts_as_one_of_a_hundred_samples_a_second(rate, kept):
    fast = logged(rate)
    (each,) = RigDataset.of([fast]).runs
    seen, whole = each.observation, from_setting_off(fast).observation
    assert np.array_equal(seen.time, whole.time[::kept])
    assert np.array_equal(seen.values, whole.values[:, ::kept])
    assert np.array_equal(seen.counts, whole.counts[::kept])
    assert 1 / np.diff(seen.time).min() < 2 * DatasetSettings().max_sample_rate
    if kept > 1:
        assert seen.noise.tolist() == [white_noise(row) for row in seen.values]
    assert decimate(each) is each


def test_times_are_told_as_the_log_counts_them():
    run = logged(100.0)
    dataset = RigDataset.of([run])
    assert dataset.time(0)[0] == pytest.approx(0.0, abs=1e-9)
    last = run.observation.time[run.observation.counts][-1]
    assert dataset.logged_time(0)[-1] == pytest.approx(last)


def test_a_run_without_samples_early_in_the_motion_is_met_by_all_it_has():
    each = logged(50.0)
    seen = each.observation
    late = slice(int(0.8 * seen.counts.sum()), None)
    rest = dataclasses.replace(
        seen, time=seen.time[late], values=seen.values[:, late], counts=seen.counts[late]
    )
    few = dataclasses.replace(rest, counts=rest.counts & (np.arange(len(rest.time)) < 1))
    dataset = RigDataset.of([dataclasses.replace(each, observation=few)])
    early = _early_samples(dataset, 0, InitialZetaSettings().window)
    assert early.all()
    assert len(early) == 1


def test_a_warmed_model_compiles_nothing_when_it_predicts(compiled, pool):
    jax.clear_caches()  # another file may have asked for the same
    dataset = dataset_with()
    filtering = AugmentedModel((effect_class("measurement_filter"),))
    dataset.compile(pool, predict, filtering)
    assert compiled
    compiled.clear()
    for run in range(len(dataset.runs)):
        # As a secant step gives it, and as numpy does.
        for log_zeta in (0.0, np.float64(0.01)):
            dataset.prediction(filtering, run, log_zeta, np.array([0.02]))
    assert not compiled


STAYING = ("loosening", "surface_slope", "grouser_height", "wheel_radius", "sinkage_gain")


@pytest.mark.parametrize("name", STAYING)
def test_plates_that_stay_above_the_sand_change_no_number(name):
    # One program simulates each of them.
    shared = AugmentedModel(tuple(map(effect_class, STAYING)))
    dataset = dataclasses.replace(dataset_with(), shared=shared)
    narrow = dataclasses.replace(dataset.with_fewer_plates(), shared=shared)
    carried, whole = (each.trials[0].simulator.wheel.cut() for each in (narrow, dataset))
    assert carried.outline.x.size < whole.outline.x.size
    model = AugmentedModel((effect_class(name),))
    at = model.null() + np.array([float(each.scale is not None) for each in model.free])
    for run in SLOW_RUNS:
        ours, theirs = (each.prediction(model, run, -0.05, at) for each in (narrow, dataset))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=ROUNDING)


def test_what_sinks_past_the_plates_carried_has_no_numbers():
    dataset = dataset_with()
    narrow = dataset.with_fewer_plates()
    limit = MAX_COVERED_SHARE * float(narrow.trials[0].simulator.wheel.cut().sinkage_limit)
    z, nothing = dataset.channels.index("z"), np.zeros(0)
    for log_zeta in (0.0, -1.0):
        deepest = -dataset.prediction(AugmentedModel(), 0, log_zeta, nothing)[z].min()
        told = narrow.prediction(AugmentedModel(), 0, log_zeta, nothing)
        assert np.isnan(told).all() == (deepest > limit) == (log_zeta < 0)


# Of the typical size: one that slows the wheel down, and one that drives it away.
@pytest.mark.parametrize(("damping", "runs_away"), [(1.0, False), (-30.0, True)])
def test_a_wheel_that_runs_away_has_no_numbers(damping, runs_away):
    model = AugmentedModel((effect_class("horizontal_viscous"),))
    told = dataset_with().prediction(model, 0, 0.0, np.array([damping]))
    assert np.isnan(told).all() == runs_away
    assert np.isfinite(told).all() == (not runs_away)


# Of grousers of 18 mm: one that leaves some, and one that takes more than there is.
@pytest.mark.parametrize(("excess", "is_wheel"), [(-0.017, True), (-0.019, False)])
def test_a_wheel_whose_grousers_are_shorter_than_none_has_no_numbers(excess, is_wheel):
    model = AugmentedModel((effect_class("grouser_height"),))
    at = np.array([model.free[0].coordinate(excess)])
    told = dataset_with().prediction(model, 0, 0.0, at)
    assert np.isfinite(told).all() == is_wheel
    assert np.isnan(told).all() == (not is_wheel)


def test_a_wheel_that_sinks_as_deep_as_its_plates_reach_keeps_them_all():
    each = coarse("deep", recorded(setup_of(zeta=0.2)))
    dataset = RigDataset.of([each])
    assert dataset.with_fewer_plates() is dataset


def test_a_bare_rim_carries_the_plates_that_reach_the_sand():
    setup = setup_of()
    setup.wheel = WheelSetUp("plain")
    setup.start.sinkage = 0.02
    each = prepare_run("bare", recorded(setup), step=0.01)
    whole = RigDataset.of([dataclasses.replace(each, setup=setup, trial=setup.trial(interval=0))])
    narrow = whole.with_fewer_plates()
    carried, every = (e.trials[0].simulator.wheel for e in (narrow, whole))
    assert carried.rim_plates < 0.75 * every.rim_plates
    model, nothing = AugmentedModel(), np.zeros(0)
    ours, theirs = (e.prediction(model, 0, 0.0, nothing) for e in (narrow, whole))
    # Plates of 1 mm, shorter by under a hundredth: less than the instruments' noise [m].
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=10e-6)
