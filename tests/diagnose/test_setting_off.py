"""Runs from where the wheel sets off: what is left out, and why."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from diagnose.dataset import DatasetSettings, RigDataset
from diagnose.setting_off import from_setting_off
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.simulation.statics import zeta_from_sinkage
from drftjax.simulation.trial import Trial
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

REST = 0.5
PROFILE = ([0.0, REST, 1.0, 2.0], [0.0, 0.0, 0.5, 0.5])
# Knots and rows are sums of steps [s].
CLOCK = 1e-9
# The mean of eleven readings of 20 um is off by 6 um; three times that [m].
READING = 18e-6


def run_of(profile=PROFILE, vx: list[float] | None = None, **options) -> PreparedRun:
    return coarse("run", recorded(setup_of(profile, vx=vx), **options))


def test_the_rest_is_left_out_and_time_counts_from_its_end():
    whole = run_of()
    found = from_setting_off(whole)
    np.testing.assert_allclose(found.trial.time, [0.0, 0.5, 1.5])
    np.testing.assert_allclose(found.trial.omega, [0.0, 0.5, 0.5])
    assert found.setup is whole.setup
    kept = whole.observation.time >= REST - CLOCK
    np.testing.assert_allclose(found.observation.time, whole.observation.time[kept] - REST)
    np.testing.assert_array_equal(found.observation.values, whole.observation.values[:, kept])
    np.testing.assert_array_equal(found.observation.noise, whole.observation.noise)
    assert found.trial.rows * float(found.trial.step) == pytest.approx(1.5, abs=CLOCK)
    assert found.rest_left_out == pytest.approx(REST)


def test_a_dataset_leaves_the_rest_out_unless_it_is_told_to_keep_it():
    whole = run_of()
    (cut,) = RigDataset.of([whole]).runs
    assert cut.rest_left_out == pytest.approx(REST)
    (kept,) = RigDataset.of([whole], DatasetSettings(with_first_rest=True)).runs
    assert kept is whole


def test_a_slow_start_is_not_taken_for_more_of_the_rest():
    """Within what counts as rest the wheel has begun to turn: the rest is cut once."""
    found = from_setting_off(run_of(([0.0, REST, 2.5], [0.0, 0.0, 0.01])))
    assert from_setting_off(found) is found


def test_it_starts_where_the_wheel_stood_at_last():
    whole = run_of(noise=0.0)
    moved = whole.observation.values + 1e-3 * (whole.observation.time > 0.25)
    found = from_setting_off(replace(whole, observation=replace(whole.observation, values=moved)))
    x, z = np.asarray(whole.trial.start.position) + 1e-3
    np.testing.assert_allclose(found.trial.start.position, [x, z], atol=READING)


def test_a_wheel_that_stands_rolls_on_as_in_the_whole_run():
    whole = run_of(noise=0.0)
    found = from_setting_off(whole)
    of_whole, of_rest = whole.trial.run(), found.trial.run()
    skipped = round(REST / float(whole.trial.step))
    for name in ("x", "z"):
        late = np.asarray(getattr(of_whole, name))[skipped:]
        np.testing.assert_allclose(getattr(of_rest, name), late, atol=READING)


def test_a_run_that_moves_at_once_settles_was_not_recorded_or_is_driven_stays():
    at_once = run_of(([0.0, 0.5, 2.0], [0.0, 0.5, 0.5]))
    assert from_setting_off(at_once) is at_once
    whole = run_of()
    seen = whole.observation
    late = replace(whole, observation=seen.thinned(slice(30, None)))
    assert from_setting_off(late) is late
    sinking = seen.values - 1e-2 * seen.time
    settles = replace(whole, observation=replace(seen, values=sinking))
    assert from_setting_off(settles) is settles
    driven = run_of(vx=[0.0, 0.0, 0.05, 0.05])
    assert from_setting_off(driven) is driven
    looped = replace(whole, made_in_loop=recorded(setup_of(PROFILE)))
    assert from_setting_off(looped) is looped


def test_a_trace_of_zeta_moves_a_pulled_wheel_far_while_it_stands_and_little_once_it_rolls():
    """Why: at the zeta that just carries the wheel, a derivative says nothing of what follows."""
    profile = ([0.0, 1.0, 2.0, 4.0], [0.0, 0.0, 0.5, 0.5])
    setup = setup_of(profile)
    setup.effects = [{"name": "surface_slope", "slope": 0.05}]
    whole = setup.trial(interval=0)
    edge = float(zeta_from_sinkage(whole.simulator, setup.start.sinkage))
    prepared = replace(coarse("run", recorded(setup_of(profile))), setup=setup, trial=whole)
    cut = from_setting_off(prepared).trial
    run = eqx.filter_jit(lambda trial: trial.run().z)

    def largest_change(trial: Trial) -> float:
        """Of z at any time, for a fifth of a per cent of zeta."""
        z = [
            np.asarray(
                run(eqx.tree_at(lambda t: t.simulator.terrain.zeta.value, trial, each * edge))
            )
            for each in np.arange(1.0, 1.022, 0.002)
        ]
        return float(np.abs(np.diff(z, axis=0)).max())

    # One face of the lowest grouser carries in place of two [m]; docs/theory/diagnosis-method.md.
    assert largest_change(whole) == pytest.approx(0.5e-3, rel=0.1)
    assert largest_change(cut) == pytest.approx(0.05e-3, rel=0.1)
