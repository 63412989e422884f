"""The simulation's own error in a noise floor, and what counts above it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.dataset import RigDataset, match_initial_zeta
from diagnose.gap.discretization_error import (
    changes_with_finer_plates,
    discretization_errors,
    with_finer_plates,
)
from diagnose.gap.gap import GapSettings, gaps, share_removed
from diagnose.gap.noise_floor import noise_floors
from diagnose.gap.zeta_matching import match_runs
from diagnose.model.augmented_model import AugmentedModel
from diagnose.setting_off import from_setting_off
from tests.helpers.synthetic_runs import PLATE, coarse, recorded, setup_of

PROFILE = ([0.0, 0.3, 1.3, 2.5], [0.0, 0.0, 0.9, 0.9])
# Two ways to the zeta that matches a mean sinkage: a straight line over 1 %, and secant steps to
# the end. On plates as long as these sinkage bends by a fifth over 2 % of zeta.
AGREE = 0.15
# Speeds up to 3 rad/s within 1.4 s. Of a dozen readings noise is told to a factor of two.
FAST = ([0.0, 0.3, 1.7, 2.5], [0.0, 0.0, 3.0, 3.0])
NOISE, MOTION = 20e-6, 4.0
# Draws of two commands, and of 90 % of them: shares are told to a hundredth or two.
DRAWS = 0.03
# Of intervals that are asked to hold 90 %, and see only a part of how much chance swings.
HELD = (0.80, 0.97)


@pytest.fixture(scope="module")
def run():
    return from_setting_off(coarse("run", recorded(setup_of(PROFILE), rate=100.0, noise=0.0)))


def test_the_own_error_is_what_finer_plates_leave_of_a_run_by_the_coarse(run, pool):
    case = RigDataset.of([run])
    log_zeta = match_initial_zeta(case, pool)
    own = discretization_errors(case, changes_with_finer_plates(case, log_zeta, pool))
    values = run.observation.values.copy()
    values[:, case.counts(0)] = case.prediction(AugmentedModel(), 0, log_zeta[0], np.zeros(0))
    fine = with_finer_plates(
        dataclasses.replace(run, observation=dataclasses.replace(run.observation, values=values))
    )
    assert fine.setup.wheel.plate_size == PLATE / 2
    (left,) = match_runs(RigDataset.of([fine]), AugmentedModel(), np.zeros(0), pool)
    assert own == pytest.approx(
        dict(zip(("x", "z"), np.sqrt(np.mean(left.residual**2, axis=1)), strict=True)), rel=AGREE
    )
    # These plates are 10 mm: far from nothing, and far from the millimetre of a corner.
    assert 1e-5 < own["x"] < 1e-3


def recorded_runs(*setups) -> SimpleNamespace:
    """What a gap asks of a case: how runs were set up and sampled."""
    candidates = [SimpleNamespace(setup=each) for each in setups]
    return SimpleNamespace(runs=candidates, channels=("x",), sample_interval=lambda run: 0.01)


def test_an_interval_is_of_draws_in_which_something_could_shrink():
    setup = setup_of(PROFILE)
    other = setup_of((PROFILE[0], [0.0, 0.0, 0.5, 0.5]))
    case = recorded_runs(setup, other)
    # One command shows a gap of ten floors, half of which goes; the other shows none.
    before = [np.full((1, 100), 10.0), np.full((1, 100), 1.0)]
    after = [np.full((1, 100), 5.5), np.full((1, 100), 1.0)]
    gap = gaps(case, before, after, {"x": 1.0})["x"]  # pyright: ignore[reportArgumentType]
    assert gap.interval[0] == pytest.approx(0.5, abs=DRAWS)
    assert gap.interval[1] == pytest.approx(gap.shrinkage, abs=DRAWS)
    nothing = gaps(case, after[1:] * 2, after[1:] * 2, {"x": 1.0})["x"]  # pyright: ignore
    assert not nothing.is_reducible
    assert nothing.interval == (0.0, 0.0)


def test_the_rule_of_a_reducible_gap_can_be_varied():
    case = recorded_runs(setup_of(PROFILE))
    before, after = ([np.full((1, 100), each)] for each in (1.4, 1.0))
    for settings, share in ((GapSettings(), 0.0), (GapSettings(min_excess=0.3), 1.0)):
        gap = gaps(case, before, after, {"x": 1.0}, settings)["x"]  # pyright: ignore
        assert gap.shrinkage == pytest.approx(share)
        assert gap.is_reducible == (share > 0)


def test_runs_of_one_condition_have_no_interval():
    setup = setup_of(PROFILE)
    before, after = ([np.full((1, 100), each)] * 2 for each in (10.0, 5.5))
    gap = gaps(recorded_runs(setup, setup), before, after, {"x": 1.0})["x"]  # pyright: ignore
    assert gap.interval is None
    assert gap.document()["shrinkage_interval"] is None
    assert gap.shrinkage == pytest.approx(0.5, abs=DRAWS)


def test_an_interval_holds_what_a_few_runs_more_show():
    """Where all that is left is chance, which differs from run to run."""
    random = np.random.default_rng(0)
    setups = [setup_of((PROFILE[0], [0.0, 0.0, w, w])) for w in np.linspace(0.3, 0.9, 8)]
    case = recorded_runs(*setups)
    held, narrow, cases = 0, 0, 200
    for _ in range(cases):
        before, after = (
            3.0 * np.exp(0.2 * random.standard_normal(11)),
            np.exp(0.4 * random.standard_normal(11)),
        )
        nine, fresh = slice(8), slice(8, None)
        runs = [[np.full((1, 2), each) for each in values[nine]] for values in (before, after)]
        gap = gaps(case, *runs, {"x": 1.0})["x"]  # pyright: ignore[reportArgumentType]
        low, high = gap.interval
        rms = [float(np.sqrt(np.mean(each[fresh] ** 2))) for each in (before, after)]
        held += low <= share_removed(*rms, 1.0) <= high
        narrow += high - low < 0.02
    assert HELD[0] * cases < held < HELD[1] * cases
    assert narrow == 0


def test_without_repeats_a_wheel_that_is_read_seldom_is_no_noise(pool):
    """At 8 Hz the readings of a wheel that speeds up bend by far more than their noise."""
    run = coarse("run", recorded(setup_of(FAST), rate=8.0, noise=NOISE))
    case = RigDataset.of([run])
    readings = run.observation.by_channel()["x"][1]
    assert readings > MOTION * NOISE
    (left,) = match_runs(case, AugmentedModel(), np.zeros(0), pool)
    floors, how = noise_floors(
        case, [left.residual], [left.residual], {"x": 0.0, "z": 0.0}, lambda run: np.zeros(0)
    )
    assert "No run was repeated" in how
    assert floors["x"] < MOTION / 2 * NOISE
