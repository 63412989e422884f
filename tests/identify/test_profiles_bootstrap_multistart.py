"""Beyond one fit: starting points, profiles, bootstraps, zeta over time, other speeds."""

import dataclasses
import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.runlog.hdf5.api import read_result, write_run
from drftjax.setups.fitted_model import FIT_SCHEMA, read_model
from drftjax.setups.terrain_setup import ZetaKnots
from identify.design.required_speed import _error, add_required_speeds, required_speed
from identify.fit_constant import MODEL_ERROR, fit
from identify.parameters.parameter import own, shared
from identify.parameters.phase_zeta import PhaseZeta, phases_of, with_phases, zeta_phases
from identify.solver.batched_levenberg_marquardt import BatchedLevenbergMarquardt
from identify.solver.multistart import MultistartSummary, best_start, starting_points
from identify.solver.whitening import Whitening
from identify.uncertainty.bootstrap import (
    one_step_draws,
    refit_draws,
    resample_runs,
    simulated_noise,
)
from tests.helpers.synthetic_runs import (
    FAST_STEP,
    NOISE,
    SLOW,
    coarse,
    recorded,
    setup_of,
    write_believed_setup,
)
from tests.studies.coverage import LAMBDA, ZETA, coverage

# Two-sided 90 % of a normal distribution, in standard errors; of three such values one lies farther
# off than 2.5 in 30 cases, and here the draw is fixed.
NINETY, FAR = 1.645, 2.5
# One Gauss-Newton step and a whole refit differ by the bend of the simulation over the errors.
LINEAR = 0.25
# Where the simulation is straight over the errors, as here, the profile is the normal interval.
STRAIGHT = 0.1
# A run alone, its step chosen again, near the bound of lambda where slopes change.
REACH = 0.25
# Two solvers stop within this part of an error of one another.
SAME_FIT = 0.5
# A standard deviation of so many draws is known to 1 / sqrt(2 n) of itself; three times that.
DRAWS = 400
SCATTER = 3 / np.sqrt(2 * DRAWS)
# Sums of a few products of doubles of order one.
ROUNDING = 1e-14
# Phases of a second tell zeta to a hundredth, and the steady one to a thousandth.
PHASE = 0.01
# Zetas that differ by a hundredth, by straight lines: a tenth of the difference.
STRAIGHT = 0.1
# What a steady zeta is off by where a path of it is read between its phases' ends.
ROUGHLY = 0.02

# Speeds up, goes and slows down again.
WHOLE = ([0.0, 0.25, 0.85, 1.45, 2.05, 2.3], [0.0, 0.0, 0.4, 0.4, 0.0, 0.0])
WHOLE_STEP = 5e-4


@pytest.fixture(scope="session")
def runs():
    return [coarse(f"run_{k}", recorded(setup_of(SLOW, z), k)) for k, z in enumerate((0.75, 0.75))]


@pytest.fixture(scope="session")
def result(runs):
    return fit(runs, [shared("zeta"), own("rig.drawbar_load")])


@pytest.fixture(scope="session")
def untold():
    """A fit to one slow run, which does not tell lambda."""
    run = coarse("slow", recorded(setup_of(SLOW, 0.75), 4, noise=1e-4))
    return fit([run], [own("zeta"), shared("lambda")])


# Several starting points ------------------------------------------------------------------------


def test_every_start_of_a_plain_problem_ends_in_one_optimum(result):
    estimate = result.estimate
    coordinates, starts = best_start(estimate.problem, 2, 4)
    assert starts == MultistartSummary(count=4, same=4, other=0, lost=0, usual=True)
    assert str(starts) == "4 of 4 starting points ended in the same optimum, the best"
    error = np.sqrt(np.diag(estimate.covariance)[: len(estimate.flat)])
    descent = BatchedLevenbergMarquardt(estimate.problem, 2)
    assert np.all(np.abs(descent.flat(coordinates) - estimate.flat) < SAME_FIT * error)


def test_starting_points_begin_with_the_usual_one_and_stay_in_bounds(result):
    bounded = own("rig.drawbar_load", bounds=(-1.0, 5.0))
    problem = dataclasses.replace(
        result.estimate.problem, parameters=(result.estimate.problem.parameters[0], bounded)
    )
    descent = BatchedLevenbergMarquardt(problem, 2)
    points = starting_points(descent, 9, np.random.default_rng(1))
    np.testing.assert_array_equal(points[0], descent.start())
    assert len(np.unique(points[:, 0])) == 9
    loads = np.asarray(bounded.bijector.value(jnp.asarray(points[:, 1:])))
    assert np.all((loads > -1.0) & (loads < 5.0))
    # Over most of the way between them.
    assert loads.min() < 0.5 < 3.5 < loads.max()


@pytest.mark.parametrize("count", [0, -1, 1001])
def test_numbers_of_starts_that_make_no_sense_are_refused(runs, count):
    with pytest.raises(InputError, match="number of starts"):
        fit(runs, [own("zeta")], starts=count)


# Profile likelihood -----------------------------------------------------------------------------


def test_profile_of_a_well_told_value_is_its_normal_interval(result):
    (profile,) = result.profile("zeta").profiles
    value = result.shared[ZETA]
    low, high = (np.array([profile.low, profile.high]) - value.value) / (NINETY * value.error)
    assert abs(low + high) / 2 < STRAIGHT
    assert (high - low) / 2 == pytest.approx(1.0, abs=STRAIGHT)
    assert np.all(np.diff(profile.value) > 0)
    assert profile.rise[[0, -1]].min() > NINETY**2
    assert str(profile).startswith("zeta: 90 % profile interval 0.7")
    assert profile.table().row_count == len(profile.value)


def test_profile_without_an_end_says_so(untold):
    (profile,) = untold.profile("lambda").profiles
    assert not (np.isfinite(profile.low) and np.isfinite(profile.high))
    assert "no lower end" in str(profile) or "no upper end" in str(profile)


def test_profile_of_what_was_not_fitted_is_refused(result):
    with pytest.raises(InputError, match=r"'zeto' is asked for, .* did you mean zeta\?"):
        result.profile("zeto")


def test_whitening_gives_the_inverse_of_the_covariance_it_supposes():
    random = np.random.default_rng(0)
    counts = np.ones((1, 1, 6), bool)
    offset = random.uniform(0.5, 2.0, (1, 1, 6))
    phase = np.array([[0, 0, 0, 1, 1, 1]])
    whitening = Whitening(counts.astype(float), offset, phase)
    same = phase[0][:, None] == phase[0]
    supposed = np.eye(6) + np.where(same, np.outer(offset, offset), 0)
    root = whitening.apply(np.eye(6)[None, None])[0, 0]
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(supposed), rtol=0, atol=ROUNDING)
    coloured = whitening.colour(np.eye(6)[None, None])[0, 0]
    np.testing.assert_allclose(coloured.T @ coloured, supposed, rtol=0, atol=ROUNDING)


# Bootstrap --------------------------------------------------------------------------------------


def test_linearised_draws_are_those_of_full_refits(result):
    estimate = result.estimate
    noise = simulated_noise(estimate, 4, np.random.default_rng(5))
    error = np.sqrt(np.diag(estimate.covariance)[: len(estimate.flat)])
    step = (one_step_draws(estimate, noise, np.random.default_rng(0)) - estimate.flat) / error
    full = (refit_draws(estimate, noise) - estimate.flat) / error
    assert np.abs(full).max() > 2 * LINEAR
    np.testing.assert_allclose(step, full, rtol=0, atol=LINEAR)


def test_bands_hold_the_readings_and_errors_are_the_fits(result):
    drawn = result.bootstrap(DRAWS)
    noise = drawn.bootstraps[0]
    assert noise.over == "noise"
    errors = np.array([value.error for value in result.values.values()])
    # Both come from the same noise: one by draws, one by algebra.
    np.testing.assert_allclose(noise.error, errors, rtol=SCATTER)
    for run in drawn.runs:
        low, high = drawn.bands[run.name]["z"]
        inside = (run.recorded[1] >= low) & (run.recorded[1] <= high)
        # The band also allows for the model's own error, which these runs do not have: nine in ten
        # and more lie in it, and it is no wider than twice what noise and model ask for.
        assert inside[run.counts].mean() > 0.9
        assert np.nanmax(high - low) < 2 * 2 * NINETY * np.hypot(NOISE, MODEL_ERROR["z"])
    assert len(drawn.bootstraps) == 1  # two runs say nothing of the scatter between runs


def test_bootstrap_over_runs_sees_what_runs_differ_by():
    """One zeta fitted to runs that have two: the noise is small, the runs' difference is not."""
    zetas = (0.74, 0.75, 0.76, 0.74, 0.76)
    runs = [coarse(f"r{k}", recorded(setup_of(SLOW, z), k)) for k, z in enumerate(zetas)]
    estimate = fit(runs, [shared("zeta")]).estimate
    moves = resample_runs(estimate, DRAWS, np.random.default_rng(2))[:, 0]
    expected = np.std(np.log(zetas)) / np.sqrt(len(zetas))
    assert moves.std() == pytest.approx(expected, rel=SCATTER + STRAIGHT)


def test_too_few_draws_are_refused(result):
    with pytest.raises(InputError, match="number of draws is 5"):
        result.bootstrap(5)


# zeta by phase, in time, and a start that rolls ---------------------------------------------------


@pytest.fixture(scope="session")
def phased():
    """A run whose zeta differs from phase to phase, and one that never slows down."""
    setup = setup_of(WHOLE, 0.75)
    setup.integrator.step = WHOLE_STEP
    setup.terrain.zeta = ZetaKnots(
        [0, 0.24, 0.26, 0.84, 0.86, 1.44, 1.46, 2.3],
        [0.75, 0.75, 0.72, 0.72, 0.78, 0.78, 0.74, 0.74],
    )
    return coarse("whole", recorded(setup, 1), step=WHOLE_STEP)


def test_phases_follow_the_command(phased):
    assert [(round(b, 2), round(e, 2), n) for b, e, n in phases_of(phased.setup)] == [
        (0.0, 0.25, "stand"),
        (0.25, 0.85, "accelerate"),
        (0.85, 1.45, "steady"),
        (1.45, 2.05, "decelerate"),
        (2.05, 2.3, "rest"),
    ]
    backward = setup_of(([0.0, 1.0, 2.0, 3.0], [-0.4, -0.4, -0.1, -0.1]))
    assert [name for *_, name in phases_of(backward)] == ["steady", "decelerate", "steady"]
    back = setup_of(([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.4, 0.4, -0.2, -0.2]))
    assert [(round(b, 2), round(e, 2), n) for b, e, n in phases_of(back)] == [
        (0.0, 1.0, "accelerate"),
        (1.0, 2.0, "steady"),
        (2.0, 2.67, "decelerate"),
        (2.67, 3.0, "accelerate"),
        (3.0, 4.0, "steady"),
    ]


@pytest.mark.parametrize("late", [0.0, 1e-11])
def test_a_phase_begins_later_than_clocks_round(phased, late):
    time = phased.observation.time.copy()
    last = int(np.flatnonzero(phased.observation.counts)[-1])
    time[last] = 2.05 + late
    counts = np.arange(len(time)) <= last
    observation = dataclasses.replace(phased.observation, time=time, counts=counts)
    fitted = zeta_phases([dataclasses.replace(phased, observation=observation)])
    assert fitted[-1].quantity.label == "zeta.decelerate"


def test_zeta_by_phase_reads_each_phase(phased):
    (each,) = with_phases([phased], zeta_phases([phased]))
    zeta = each.trial.simulator.terrain.zeta
    zeta = eqx.tree_at(lambda z: z.level, zeta, jnp.arange(1.0, 6.0))
    nothing = Command(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
    read = [float(zeta(jnp.asarray(t), nothing)) for t in (0.1, 0.5, 1.2, 1.8, 2.2)]
    assert read == [1.0, 2.0, 3.0, 4.0, 5.0]
    knots = zeta.knots()
    assert np.interp(1.8, knots.time, knots.value) == 4.0


def test_what_is_known_of_zeta_is_known_of_each_phase(phased, runs):
    steady, load = own("zeta.steady"), own("rig.drawbar_load")
    known = {"bounds": (0.5, 0.9), "prior": (0.7, 0.1), "start": 0.8}
    fitted = zeta_phases([phased], [load, shared("zeta", **known), steady])
    names = ("stand", "accelerate", "decelerate")
    assert repr(fitted) == repr([*(shared(f"zeta.{n}", **known) for n in names), load, steady])
    assert repr(zeta_phases(runs, [load])[-2:]) == repr([own("zeta.steady"), load])


def test_zeta_of_every_phase_is_found(phased):
    fitted = zeta_phases([phased])
    # What a wheel at rest does is not compared, so its zeta is not fitted.
    names = ["stand", "accelerate", "steady", "decelerate"]
    assert [p.quantity.label for p in fitted] == [f"zeta.{name}" for name in names]
    (run,) = fit([phased], fitted).runs
    for name, truth in zip(names[1:], (0.72, 0.78, 0.74), strict=True):
        value = run.values[f"terrain.zeta.{name}"]
        assert abs(value.value - truth) < FAR * value.error
        assert value.error < PHASE * truth
    assert isinstance(run.setup.terrain.zeta, ZetaKnots)
    assert isinstance(run.setup.trial().simulator.terrain.zeta(jnp.asarray(1.2), None), jnp.ndarray)


def test_a_phase_that_no_run_has_is_refused(runs):
    with pytest.raises(InputError, match="no run has samples in the phase 'decelerate'"):
        fit(runs, [own("zeta.decelerate")])
    assert not isinstance(runs[0].trial.simulator.terrain.zeta, PhaseZeta)


def test_a_start_that_rolls_is_found():
    """Recording begins while the wheel turns; at the wrong speed it slips for a moment more."""
    setup = setup_of(([0.0, 0.6], [0.5, 0.5]), 0.75)
    setup.start.speed = 0.02
    each = coarse("rolls", recorded(setup, 3, rate=200.0, noise=2e-6))
    assert each.setup.start.x == each.observation.values[0, 0]
    (run,) = fit([each], [own("zeta"), own("start.speed")]).runs
    speed = run.values["start.speed"]
    assert abs(speed.value - 0.02) < FAR * speed.error
    # It slips for some ten readings, which tell a tenth of it.
    assert speed.error < 0.2 * 0.02
    assert run.setup.start.speed == speed.value


# Other speeds -----------------------------------------------------------------------------------


def test_where_lambda_is_not_told_the_speed_that_would_tell_it_is_named(untold):
    told = add_required_speeds(untold)
    (finding,) = [f for f in told.findings if "could be identified" in f]
    speed = float(finding.split("from about ")[1].split(" rad/s")[0])
    # The paper's wheel speed of 0.5 rad/s does not tell it, and eight times that does.
    assert 0.5 < speed < 8.0
    assert any("cannot be identified" in f and "±" in f for f in told.findings)


def test_the_speed_named_starts_from_the_error_that_the_fit_has():
    """At the run's own speed the same run would be told as badly as it was."""
    run = coarse("slow", recorded(setup_of(SLOW, 0.75), 4))
    result = fit([run], [own("zeta"), shared("lambda")])
    (value,) = result.shared.values()
    assert result.estimate is not None
    setup = result.runs[0].setup
    same = _error(result.estimate, 0, setup, "terrain.inertial_coefficient", 1.0)
    assert same == pytest.approx(value.error, rel=REACH)
    # What is believed, 1.1, is what the error is held against, whatever the fit says.
    assert all(
        "of the believed 1.1" in f
        for f in add_required_speeds(result).findings
        if "from about" in f
    )


def test_where_a_fit_starts_is_no_matter_to_the_speed_named():
    run = coarse("slow", recorded(setup_of(SLOW, 0.75), 4))
    result = fit([run], [own("zeta", start=0.6), shared("lambda", start=8.0)])
    setup = result.runs[0].setup
    (value,) = result.shared.values()
    assert _error(result.estimate, 0, setup, LAMBDA, 1.0) == pytest.approx(value.error, rel=REACH)


def test_a_zeta_by_phase_goes_along_to_other_speeds():
    run = coarse("slow", recorded(setup_of(SLOW, 0.75), 4, noise=1e-4))
    phases = [shared("zeta.stand"), own("zeta.accelerate"), own("zeta.steady")]
    result = fit([run], [*phases, shared("lambda")])
    told = set(add_required_speeds(result).findings) - set(result.findings)
    assert any(sentence.startswith("lambda could") for sentence in told)
    # By phase there too, so that it is as unknown as in the fit.
    setups = [result.runs[0].setup]
    same = _error(result.estimate, 0, setups[0], LAMBDA, 1.0)
    assert same == pytest.approx(result.shared[LAMBDA].error, rel=REACH)
    assert required_speed(result.estimate, setups, "terrain.zeta.stand").startswith(
        "zeta.stand could"
    )


def test_where_all_is_told_no_speed_is_named(result):
    assert add_required_speeds(result).findings == result.findings


# Coverage ---------------------------------------------------------------------------------------


def test_ninety_percent_intervals_hold_the_truth_about_as_often():
    """Eight batches: 16 and 8 intervals. Fewer than these hold by chance once in a thousand."""
    # Twice the study's step: simulation and fit have the same, and derivatives are slopes by it at
    # twice this speed, too.
    found = coverage(8, step=FAST_STEP)
    assert found.share(ZETA) >= 10 / 16
    assert found.share(LAMBDA) >= 4 / 8
    # And intervals twice too wide would hold nearly all, with a scatter of half the error.
    # (Sixteen draws tell a scatter of one to a fifth.)
    assert found.off[ZETA].std() > 0.5


# By the command line ----------------------------------------------------------------------------


@pytest.fixture(scope="session")
def logs(tmp_path_factory):
    """The files of `runs`: what is fitted to them there and here is one compiled program."""
    folder = tmp_path_factory.mktemp("two")
    paths = [folder / f"run_{k}.h5" for k in range(2)]
    for k, path in enumerate(paths):
        write_run(path, recorded(setup_of(SLOW, 0.75), k))
    return paths


@pytest.fixture(scope="session")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("more") / "run.h5"
    write_run(path, recorded(setup_of(SLOW, 0.74), 1))
    return path


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    return write_believed_setup(tmp_path_factory.mktemp("model") / "model.toml")


def test_command_profiles_and_draws(drft, logs, model, tmp_path):
    options = [
        *("--model", model, "--share", "zeta", "--own", "rig.drawbar_load"),
        *("--starts", "4", "--profile", "zeta", "--bootstrap", "50"),
    ]
    answer = drft("fit", *logs, *options, "-o", tmp_path / "fit")
    assert answer.code == 0, answer
    for said in (
        "4 of 4 starting points",
        "90 % profile interval",
        "bootstrap over noise, 50 draws",
    ):
        assert said in answer.out
    document = json.loads((tmp_path / "fit.json").read_text())
    assert document["starts"]["same"] == 4
    assert document["profiles"][0]["low"] < document["profiles"][0]["high"]
    assert document["bootstraps"][0]["draws"] == 50
    group = read_result(tmp_path / "fit.h5", FIT_SCHEMA)["run_0"]
    assert np.nanmax(group["z_high"] - group["z_low"]) > 0


@pytest.mark.parametrize("way", ["phases", "path"])
def test_command_fits_zeta_over_time(drft, log, model, tmp_path, way):
    options = ["--model", model, *(["--own", "zeta"] if way == "phases" else [])]
    answer = drft("fit", log, "--zeta", way, *options, "-o", tmp_path / "fit")
    assert answer.code == 0, answer
    for ending in (".json", ".h5"):
        zeta = read_model(tmp_path / f"fit{ending}", "run").terrain.zeta
        assert isinstance(zeta, ZetaKnots)
        assert np.interp(1.2, zeta.time, zeta.value) == pytest.approx(0.74, rel=ROUGHLY)


def test_command_carries_the_bounds_of_zeta_over_to_its_phases(drft, log, tmp_path):
    toml = tmp_path / "fit.toml"
    toml.write_text('[[parameter]]\nname = "zeta"\nbounds = [0.3, 0.7]\n')
    refusal = drft("fit", log, "--zeta", "phases", "--parameters", toml).refusal
    assert "terrain.zeta.stand is 0.7823, outside the bounds 0.3 to 0.7" in refusal


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--zeta", "knots"], "--zeta is 'knots', must be one of constant, phases, path"),
        (["--zeta", "path", "--share", "zeta"], "zeta is what a path is of; leave it out"),
        (["--zeta", "path", "--own", "start.x"], "each path finds its own start.x"),
        (["--zeta", "path", "--starts", "4"], "--zeta path goes from one start to one answer"),
        (["--zeta", "path", "--autoregressive"], "leave --autoregressive out"),
        (["--zeta", "phases", "--knots", "0.5"], "--knots is the spacing of the knots of --zeta"),
        (["--zeta", "path", "--knots", "0"], "the knot spacing is 0 s, must be positive"),
        (["--starts", "0"], "number of starts is 0"),
        (["--bootstrap", "3"], "number of draws is 3"),
        (["--zeta", "phases", "--profile", "zeta"], "'zeta' is asked for, which is not fitted"),
        (["--profile", "lamda"], "'lamda' is asked for, which is not fitted; did you mean lambda"),
    ],
)
def test_options_that_cannot_be_are_refused(drft, log, arguments, said):
    assert said in drft("fit", log, *arguments).refusal
