"""`drftjax.fit`: files, run logs and models in; values, covariance, summaries and figures out."""

import copy
import dataclasses
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

import drftjax
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import prepare_runs
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured
from drftjax.setups.terrain_setup import ZetaKnots
from identify.fit_constant import FitSettings
from identify.fit_constant import fit as fit_runs
from identify.parameters.parameter import shared
from identify.solver.levenberg_marquardt import solve
from identify.solver.settings import BatchedSolverSettings, SolverSettings
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# Two programs of one fit sum in another order, and stop within a small part of the errors.
SAME_FIT = 0.1
# A value at its bound is within a thousandth of the interval, 0.76 to 0.9.
NEAR_BOUND = 1.4e-4
# Covariances of a few numbers, scaled in another order.
ROUNDING = 1e-12
# The toy problem is linear; its noise is 0.01, and solvers stop within a small part of the errors.
LINEAR = 2e-5

BRACKETS = "sand [bold]x"


@pytest.fixture(scope="session")
def model():
    """The wheel and rig of the virtual runs, with the sand as believed."""
    setup = setup_of(SLOW)
    setup.terrain.zeta = 0.7823
    return setup


@pytest.fixture(scope="session")
def runs():
    return {
        "first": recorded(setup_of(SLOW, 0.73), 1),
        BRACKETS: recorded(setup_of(SLOW, 0.77), 2),
    }


@pytest.fixture(scope="session")
def result(runs, model):
    return drftjax.fit(runs, model, "zeta")


def test_zeta_over_the_run_is_fitted_in_one_call(runs, model):
    path = drftjax.fit(runs, model, zeta="path", knots=0.5)
    phases = drftjax.fit(runs, model, "zeta", zeta="phases")
    for index, (name, true) in enumerate(zip(runs, (0.73, 0.77), strict=True)):
        found = path.runs[index].path
        assert np.diff(found.time) == pytest.approx(0.5)
        # A wheel that stands tells zeta from one side only; it has turned for long from 1 s on.
        going = found.identified & (found.time >= 1.0)
        assert going.any()
        assert (np.abs(found.value - true) < 4 * found.error)[going].all()
        # It is reported like any fit.
        run = path.runs[index]
        assert run.status == "converged"
        assert run.rmse()["z"] < run.rmse(fitted=False)["z"]
        assert path.document()["runs"][index]["zeta_path"]["value"] == found.value.tolist()
        knots = run.setup.terrain.zeta
        np.testing.assert_allclose(knots.value, found.at(np.array(knots.time)), rtol=ROUNDING)
        steady = phases.runs[index].values["terrain.zeta.steady"]
        assert phases.runs[index].name == name
        assert abs(steady.value - true) < 4 * steady.error


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"zeta": "knots"}, "zeta is 'knots', must be one of constant, phases, path"),
        ({"zeta": "path", "parameters": "zeta"}, "zeta is what a path is of"),
        ({"zeta": "path", "starts": 2}, "from one start; leave noise and starts out"),
        ({"zeta": "path", "knots": float("nan")}, "knot spacing is nan s"),
    ],
)
def test_a_zeta_over_the_run_that_cannot_be_is_refused(runs, model, options, said):
    with pytest.raises(InputError, match=said):
        drftjax.fit(runs, model, **options)


def test_importing_identify_leaves_jax_alone():
    code = "import sys, drftjax; assert 'jax' not in sys.modules; drftjax.fit; import jax"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="fitt"):
        _ = drftjax.fitt


def test_fit_finds_what_the_runs_were_made_with(result):
    assert list(result.values) == ["zeta of first", f"zeta of {BRACKETS}"]
    for value, truth in zip(result.values.values(), (0.73, 0.77), strict=True):
        assert abs(value.value - truth) < 2 * value.error
    assert [run.status for run in result.runs] == ["converged", "converged"]


def test_covariance_residuals_and_predictions_belong_to_the_values(result, runs):
    errors = [value.error for value in result.values.values()]
    assert result.covariance.shape == (2, 2)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), errors, rtol=ROUNDING)
    for name, run in runs.items():
        left = result.predictions[name]["z"] - run.measured.z
        np.testing.assert_allclose(result.residuals[name]["z"], left, rtol=0, atol=ROUNDING)


def test_summaries_name_every_run_and_status(result):
    text, html = result.summary(), result._repr_html_()
    for name in result.residuals:
        assert name in text
        assert name in html
    assert text.count("converged") == 2
    assert html.startswith("<pre")
    assert result.plot().axes


def test_a_file_a_log_and_a_pair_are_one_run(result, runs, model, tmp_path):
    write_run(tmp_path / "first.h5", runs["first"])
    ways = [
        prepare_runs(tmp_path / "first.h5", model),
        prepare_runs(runs["first"], model),
        prepare_runs((model, runs["first"])),
        prepare_runs([str(tmp_path / "first.h5")], model),
    ]
    assert [each.name for (each,) in ways] == ["first", "run 1", "run 1", "first"]
    for (each,) in ways:
        assert each.setup.wheel == model.wheel
        np.testing.assert_array_equal(each.observation.values, ways[0][0].observation.values)
        assert each.setup.terrain.zeta == 0.7823
    (alone,) = prepare_runs(runs["first"])
    assert alone.setup.wheel.plate_size != model.wheel.plate_size


def test_single_precision_around_it_changes_nothing(result, runs, model):
    with jax.enable_x64(False):
        again = drftjax.fit({"first": runs["first"]}, model, "zeta")
        assert jnp.ones(1).dtype == jnp.float32
    ours, theirs = again.values["zeta of first"], result.values["zeta of first"]
    assert abs(ours.value - theirs.value) < SAME_FIT * theirs.error


@pytest.mark.parametrize(
    ("given", "parameters", "said"),
    [
        ("gone.h5", "zeta", "gone.h5"),
        ([], "zeta", "no run is left to fit"),
        (3.0, "zeta", "run 1 is float; a run is a file"),
        ("first", [], "no parameter is named"),
        ("first", "zeto", "did you mean zeta"),
        ("first", ["zeta", drftjax.shared("terrain.zeta")], "asked for twice"),
    ],
)
def test_what_cannot_be_fitted_is_said_in_a_sentence(runs, given, parameters, said):
    given = runs["first"] if given == "first" else given
    with pytest.raises(InputError, match=said):
        drftjax.fit(given, parameters=parameters)


def test_a_zeta_at_knots_is_no_number_to_fit(runs, model):
    model = copy.deepcopy(model)
    model.terrain.zeta = ZetaKnots([0.0, 1.0, 1.5], [0.78, 0.74, 0.7])
    said = r"run 1: its terrain\.zeta is 3 values over time, must be one number to be fitted"
    with pytest.raises(InputError, match=said):
        drftjax.fit((model, runs["first"]), parameters="zeta")


# How runs end -----------------------------------------------------------------------------------


# To (1, 2, 3) and to (1, 4, 9).
ORTHOGONAL = jnp.array([3.0, -3.0, 1.0])


class Weights(eqx.Module):
    weight: jax.Array


class Recordings(eqx.Module):
    observed: Weights


class Toy(eqx.Module):
    """Runs that record their own number plus a shared one; past `edge` no run can be simulated."""

    targets: jax.Array
    edge: jax.Array
    batch: Recordings
    shared: tuple = eqx.field(static=True, default=("shared",))

    def on_all_devices(self, values):
        return values

    def prior_residuals(self, shared, own):
        return 0 * shared, 0 * own

    def residual(self, shared, own):
        fine = own[:, :1] < self.edge
        ramp = jnp.arange(1.0, 4.0)
        left = own * ramp + shared * ramp**2 - (self.targets[:, None] * ramp + ramp**2)
        left += 0.01 * ORTHOGONAL  # noise that neither number can follow
        return jnp.where(fine, left, jnp.nan)[:, None, :]

    def rows(self, shared, own):
        return self.blocks(shared, own)

    def blocks(self, shared, own):
        residual = self.residual(shared, own)
        ramp = jnp.arange(1.0, 4.0)
        slope = jnp.stack([ramp**2, ramp], axis=-1)
        return residual, jnp.where(jnp.isfinite(residual)[..., None], slope, jnp.nan)


def toy(targets, edge):
    weight = jnp.ones((len(targets), 1, 3))
    problem = Toy(jnp.asarray(targets), jnp.asarray(edge), Recordings(Weights(weight)))
    return solve(problem, (jnp.zeros(1), jnp.zeros((len(targets), 1))))


def test_a_run_that_diverges_is_put_aside_and_the_others_converge():
    solution = toy([0.5, 5.0, 1.0], edge=2.0)
    assert solution.status == "converged"
    assert solution.active.tolist() == [True, False, True]
    shared, own = solution.coordinates
    assert float(shared[0]) == pytest.approx(1.0, abs=LINEAR)
    np.testing.assert_allclose(own[[0, 2], 0], [0.5, 1.0], rtol=0, atol=LINEAR)
    assert float(own[1, 0]) < 2.0  # the edge that it goes over
    assert not np.any(solution.residual[1])
    assert np.isfinite(solution.blocks).all()


def test_all_runs_count_where_none_diverges():
    solution = toy([0.5, 1.0], edge=2.0)
    assert solution.active.all()
    np.testing.assert_allclose(solution.coordinates[1][:, 0], [0.5, 1.0], rtol=0, atol=LINEAR)


def test_a_run_at_its_bound_says_so(runs, model):
    bounded = drftjax.own("zeta", bounds=(0.76, 0.9), start=0.8)
    result = fit_runs(prepare_runs(runs, model), [bounded])
    assert [run.status for run in result.runs] == ["at a bound", "converged"]
    document = msgspec.json.decode(msgspec.json.encode(result.document()))
    first = document["runs"][0]
    assert first["status"] == "at a bound"
    zeta = first["values"]["terrain.zeta"]
    assert zeta["at_bound"]
    assert zeta["value"] == pytest.approx(0.76, abs=NEAR_BOUND)
    assert "0.76, at a bound" in result.summary()
    assert any(f.startswith("zeta has run into its bound") for f in result.findings)


def test_bounds_far_away_are_no_bounds(runs, model, result):
    """A thousandth of so wide an interval holds all values that there are."""
    wide = drftjax.own("zeta", bounds=(1e-6, 1e6), start=0.8)
    far = fit_runs(prepare_runs(runs, model), [wide])
    assert [run.status for run in far.runs] == ["converged", "converged"]
    assert not any("bound" in each for each in far.findings)
    for run, plain in zip(far.runs, result.runs, strict=True):
        zeta, alone = (each.values["terrain.zeta"] for each in (run, plain))
        assert zeta.value == pytest.approx(alone.value, abs=SAME_FIT * alone.error)
        assert zeta.error == pytest.approx(alone.error, rel=SAME_FIT)


@pytest.mark.parametrize(
    ("coordinate", "error", "bounded"),
    [
        (-14.0, 1e-3, False),
        (-14.0, 5.0, True),
        (14.0, 0.0, True),
        (9.0, np.inf, True),
        (1, 9, False),
    ],
)
def test_a_value_is_at_a_bound_where_its_error_reaches_it(coordinate, error, bounded):
    assert drftjax.own("zeta", bounds=(0.1, 0.9)).at_bound(coordinate, error) == bounded
    assert not drftjax.own("zeta").at_bound(coordinate, error)


def test_a_run_that_cannot_be_met_leaves_the_others_as_they_are(runs, model, result):
    """Its recording is of a wheel that rises out of the sand: no zeta is large enough."""
    run = runs["first"]
    z = run.measured.z + np.linspace(0.0, 0.06, len(run.measured.time))
    rising = Measured(time=run.measured.time, x=run.measured.x, z=z)
    bad = dataclasses.replace(run, measured=rising)
    mixed = drftjax.fit({"bad": bad, BRACKETS: runs[BRACKETS]}, model, "zeta")
    ours, theirs = (each.values[f"zeta of {BRACKETS}"] for each in (mixed, result))
    assert abs(ours.value - theirs.value) < SAME_FIT * theirs.error
    assert mixed.runs[1].status == "converged"


def test_a_fit_of_fewer_steps_does_not_converge(runs):
    once = SolverSettings(max_steps=1)
    hurried = FitSettings(
        reweightings=1, solver=once, short_steps=BatchedSolverSettings(max_steps=1)
    )
    far = shared("lambda", start=20.0)
    zeta = shared("zeta", start=1.5)
    result = drftjax.fit(runs, parameters=[zeta, far], settings=hurried)
    assert result.status == "out of steps"
    assert result.steps == 1
