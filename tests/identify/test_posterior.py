"""Markov chains over a fit's values: densities that are known, real runs, files and refusals."""

import dataclasses
import json

import arviz
import equinox as eqx
import h5netcdf
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import drftjax
from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import write_run
from drftjax.setups.setup import read_setup
from identify.fit_constant import fit
from identify.parameters.parameter import own, shared
from identify.solver.problem import normal_equations
from identify.uncertainty import posterior as posterior_module
from identify.uncertainty.markov_chains import (
    POSTERIOR_SETTINGS,
    ChainStatistics,
    PosteriorSettings,
    sample_chains,
)
from identify.uncertainty.posterior import sample_posterior
from identify.uncertainty.posterior_density import PosteriorDensity
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of, write_believed_setup

ZETA = "terrain.zeta"
# A mean of n effective samples is known to 1 / sqrt(n) standard deviations, and a standard
# deviation to 1 / sqrt(2 n) of itself; three times that, of the 400 that these chains have.
MEAN, SPREAD = 3 / np.sqrt(400), 3 / np.sqrt(800)
# The ends of a 90 % interval scatter twice as much as the mean.
END = 2 * MEAN
# Central differences over so many standard deviations; the simulation bends by less over them.
STEP, SLOPE = 0.05, 0.02

SHORT = dataclasses.replace(POSTERIOR_SETTINGS, warmup=40, draws=150)
# Half of the draws tell the spread to 0.15, still.
HALF = dataclasses.replace(SHORT, draws=75)
# So few that nothing has settled.
FEW = PosteriorSettings(warmup=20, draws=20)


class Linear(eqx.Module):
    """Log density of residuals that are linear in their coordinates."""

    matrix: jax.Array
    wanted: jax.Array

    def __call__(self, at: jax.Array) -> jax.Array:
        return -0.5 * jnp.sum((self.matrix @ at - self.wanted) ** 2)


class Walled(eqx.Module):
    """Standard normal density that nothing can be simulated beyond a wall of."""

    wall: jax.Array

    def __call__(self, at: jax.Array) -> jax.Array:
        return jnp.where(at[0] < self.wall, -0.5 * jnp.sum(at**2), -jnp.inf)


@pytest.fixture(scope="module")
def runs():
    return [coarse(f"run_{k}", recorded(setup_of(SLOW, z), k)) for k, z in enumerate((0.74, 0.76))]


@pytest.fixture(scope="module")
def result(runs):
    return fit(runs, [own("zeta"), shared("lambda", bounds=(0.5, 1.5), start=1.1)])


@pytest.fixture(scope="module")
def alone(runs):
    return fit(runs[:1], [own("zeta")])


@pytest.fixture(scope="module")
def sampled(result):
    return result.sample_posterior(SHORT)


# Densities that are known ------------------------------------------------------------------------


def test_linear_residuals_have_the_posterior_of_their_normal_equations():
    random = np.random.default_rng(3)
    matrix = random.standard_normal((20, 3)) * [1.0, 10.0, 0.1]
    matrix[:, 1] += 8 * matrix[:, 0]
    wanted = random.standard_normal(20)
    mean = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    covariance = np.linalg.inv(matrix.T @ matrix)
    density = Linear(jnp.asarray(matrix), jnp.asarray(wanted))
    # Half a covariance to whiten by, so that the chains do not only echo what they were given.
    draws, course, step = sample_chains(density, mean, 0.5 * covariance, SHORT)
    assert draws.shape == (4, 150, 3)
    assert not course.diverging.any()
    assert 0.3 < step < 3
    flat = draws.reshape(-1, 3)
    error = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((flat.mean(axis=0) - mean) / error, 0, atol=MEAN)
    np.testing.assert_allclose(flat.std(axis=0) / error, 1, rtol=SPREAD)
    correlation = covariance / np.outer(error, error)
    np.testing.assert_allclose(np.corrcoef(flat.T), correlation, atol=SPREAD)
    lp = [float(density(jnp.asarray(each))) for each in draws[2, :5]]
    np.testing.assert_allclose(course.lp[2, :5], lp, rtol=1e-9)


def test_chains_do_not_pass_where_nothing_can_be_simulated_and_say_so(sampled):
    wall = 0.5
    density = Walled(jnp.asarray(wall))
    draws, course, _ = sample_chains(density, np.zeros(1), np.eye(1), SHORT)
    assert draws.max() < wall
    assert course.diverging.any()
    # A normal distribution cut off above 1/2: -phi(1/2) / Phi(1/2).
    assert draws.mean() == pytest.approx(-0.3521 / 0.6915, abs=2 * MEAN)
    told = dataclasses.replace(sampled.posterior, statistics=course).sentences()
    assert any(f"{course.diverging.sum()} of 600 transitions diverged" in each for each in told)


def test_a_density_without_a_start_is_refused():
    with pytest.raises(InputError, match="find no start about the fit"):
        sample_chains(Walled(jnp.asarray(-100.0)), np.zeros(1), np.eye(1), SHORT)


# Fits ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("adjusted", [True, False])
def test_slope_of_the_density_is_its_difference_quotient(result, adjusted):
    density = PosteriorDensity.of(result.estimate, adjusted)
    value, slope = jax.jit(jax.value_and_grad(lambda at: density(at))), []
    error = np.sqrt(np.diag(density.covariance))
    at = np.asarray(density.centre) + np.array([0.5, 1.0, -1.5]) * error
    for k in range(3):
        ahead, behind = (
            float(value(jnp.asarray(at + s * error * np.eye(3)[k]))[0]) for s in (STEP, -STEP)
        )
        slope.append((ahead - behind) / (2 * STEP))
    np.testing.assert_allclose(value(jnp.asarray(at))[1] * error, slope, atol=SLOPE)


def test_posterior_of_a_well_told_value_is_that_of_its_standard_error(alone):
    posterior = sample_posterior(alone.estimate, SHORT)
    value = alone.runs[0].values[ZETA]
    assert posterior.labels == ("zeta of run_0",)
    assert (posterior.mean[0] - value.value) / value.error == pytest.approx(0, abs=MEAN)
    assert posterior.error[0] == pytest.approx(value.error, rel=SPREAD)
    ends = (np.array([posterior.low[0], posterior.high[0]]) - value.value) / value.error
    np.testing.assert_allclose(ends, [-1.645, 1.645], atol=END)
    assert posterior.rhat.max() < 1.02
    assert posterior.effective.min() > 200


def test_every_value_within_bounds_is_as_likely_where_runs_tell_nothing(sampled):
    """At the paper's speed lambda moves nothing: uniform from 0.5 to 1.5 in itself."""
    posterior = sampled.posterior
    assert posterior.labels == ("lambda", "zeta of run_0", "zeta of run_1")
    assert posterior.mean[0] == pytest.approx(1.0, abs=MEAN / np.sqrt(12))
    assert posterior.error[0] == pytest.approx(1 / np.sqrt(12), rel=SPREAD)
    ends = posterior.low[0], posterior.high[0]
    np.testing.assert_allclose(ends, [0.55, 1.45], atol=END / np.sqrt(12))


def test_without_adjustment_residuals_are_white(alone):
    estimate = alone.estimate
    white = sample_posterior(estimate, dataclasses.replace(SHORT, adjusted=False))
    information, _ = normal_equations(estimate.solution.blocks[:1], 0, estimate.solution.residual)
    error = float(estimate.slopes[0] / np.sqrt(information[0, 0]))
    assert white.error[0] == pytest.approx(error, rel=SPREAD)
    assert error < 0.5 * alone.runs[0].values[ZETA].error
    assert "likelihood of white residuals" in white.sentences()[0]


def test_a_prior_tighter_than_the_runs_is_followed(runs, alone):
    value = alone.runs[0].values[ZETA]
    mean, error = value.value + 3 * value.error, value.error / 200
    result = fit(runs[:1], [own("zeta", prior=(mean, error))])
    white = dataclasses.replace(HALF, adjusted=False)
    posterior = sample_posterior(result.estimate, white)
    # The runs' white residuals alone have a far smaller error than the standard one.
    assert abs(posterior.mean[0] - mean) < 0.1 * abs(mean - value.value)
    assert posterior.error[0] == pytest.approx(error, rel=END)


def test_a_prior_as_good_as_the_runs_meets_them_half_way(runs, alone):
    told = alone.runs[0].values[ZETA]
    prior = (told.value + 2 * told.error, told.error)
    result = fit(runs[:1], [own("zeta", prior=prior)])
    posterior = sample_posterior(result.estimate, SHORT)
    value = result.runs[0].values[ZETA]
    assert (posterior.mean[0] - value.value) / value.error == pytest.approx(0, abs=MEAN)
    assert posterior.error[0] == pytest.approx(told.error / np.sqrt(2), rel=SPREAD)


def test_values_that_nothing_holds_have_no_posterior(runs):
    parameters = [shared(name) for name in ("zeta", "wheel.width", "terrain.bulk_density")]
    result = fit(runs[:1], parameters)
    with pytest.raises(InputError, match=r"do not determine zeta, .* without bounds or a prior"):
        result.sample_posterior(SHORT)


def test_few_draws_are_called_too_few(alone):
    posterior = sample_posterior(alone.estimate, FEW)
    assert posterior.draws.shape == (4, 20, 1)
    told = [each for each in posterior.sentences() if "have not settled" in each]
    assert len(told) == 1
    assert "effective samples at least 100" in told[0]


@pytest.mark.parametrize("name", ["chains", "warmup", "draws"])
def test_chains_that_tell_nothing_are_refused(name):
    with pytest.raises(InputError, match=f"{name} of the posterior is 1, must be at least"):
        PosteriorSettings(**{name: 1})


# Files and the command line ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(sampled, tmp_path_factory):
    stem = tmp_path_factory.mktemp("fits") / "fit.v1"
    return sampled.write(stem)


def test_netcdf_is_read_by_arviz_and_xarray(written, sampled):
    path = written[-1]
    assert path.name == "fit.v1.nc"
    posterior = sampled.posterior
    data = arviz.from_netcdf(str(path))
    assert sorted(data.groups()) == ["posterior", "sample_stats"]
    np.testing.assert_array_equal(data.posterior["lambda"], posterior.draws[..., 0])
    np.testing.assert_array_equal(data.posterior["zeta"].sel(run="run_1"), posterior.draws[..., 2])
    summary = arviz.summary(data, hdi_prob=0.9, round_to="none")
    assert summary["r_hat"].to_numpy() == pytest.approx(posterior.rhat)
    fewest = summary[["ess_bulk", "ess_tail"]].min(axis=1).to_numpy()
    assert fewest == pytest.approx(posterior.effective)
    for name in (each.name for each in dataclasses.fields(ChainStatistics)):
        stored = data.sample_stats[name]
        np.testing.assert_array_equal(stored, getattr(posterior.statistics, name))
    assert data.sample_stats["diverging"].dtype == bool
    with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as plain:
        assert plain["zeta"].dims == ("chain", "draw", "run")
        assert plain["lambda"].attrs["units"] == "1"
        assert plain.attrs["likelihood"] == "adjusted"
    with h5netcdf.File(path, "r") as file:
        assert file.attrs["schema"] == "drft-posterior"


def test_document_and_table_tell_the_posterior(written, sampled):
    document = json.loads(written[0].read_text())["posterior"]
    posterior = sampled.posterior
    assert document["chains"] == 4
    assert document["divergences"] == posterior.divergences
    zeta = document["values"]["zeta of run_0"]
    assert zeta["error"] == posterior.error[1]
    assert (zeta["low"], zeta["high"]) == (posterior.low[1], posterior.high[1])
    summary = sampled.bootstrap(50).summary(160)
    (row,) = (line for line in summary.splitlines() if line.startswith("│ zeta of run_0"))
    cells = [cell.strip() for cell in row.strip("│").split("│")]
    assert cells[2] == "-"
    assert " to " in cells[3]
    assert cells[4] == f"{posterior.low[1]:.5g} to {posterior.high[1]:.5g}"


def test_a_result_without_methods_has_no_table_of_them(result):
    assert result.interval_tables() == []
    assert result.document()["posterior"] is None


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run.h5"
    write_run(path, recorded(setup_of(SLOW, 0.75), 1))
    return path


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return write_believed_setup(tmp_path_factory.mktemp("model") / "model.toml")


def test_command_writes_draws_once_and_again(drft, log, model, tmp_path, monkeypatch):
    monkeypatch.setattr(sample_posterior, "__defaults__", (FEW, None))
    stem = tmp_path / "new" / "fit"
    for _ in range(2):
        answer = drft("fit", log, "--model", model, "--own", "zeta", "--posterior", "-o", stem)
        assert answer.code == 0, answer
        assert answer.err == ""
    assert "4 chains of 20 draws" in answer.out
    assert "fit.nc" in answer.out.splitlines()[-1]
    assert arviz.from_netcdf(str(stem.with_suffix(".nc"))).posterior.sizes["draw"] == 20


def test_a_netcdf_file_of_others_is_kept(drft, log, tmp_path):
    theirs = tmp_path / "fit.nc"
    xarray.Dataset({"t": ("x", [1.0])}).to_netcdf(theirs, engine="h5netcdf")
    before = theirs.read_bytes()
    answer = drft("fit", log, "--posterior", "-o", tmp_path / "fit")
    assert "fit.nc is an HDF5 file that holds no simulation or fit" in answer.refusal
    theirs.write_text("a table")
    assert "fit.nc" in drft("fit", log, "--posterior", "-o", tmp_path / "fit").refusal
    assert theirs.read_text() == "a table" != before


def test_options_that_have_no_posterior_are_refused(drft, log):
    answer = drft("fit", log, "--zeta", "path", "--posterior")
    assert "leave --starts, --profile, --bootstrap and --posterior out" in answer.refusal
    answer = drft("fit", log, "--cluster", "local", "--posterior")
    assert "--posterior and --model out" in answer.refusal
    with pytest.raises(InputError, match="leave posterior out"):
        drftjax.fit([log], zeta="path", posterior=SHORT)


def test_without_the_extra_its_installation_is_named(drft, log, monkeypatch):
    gone = lambda name: None if name == "blackjax" else name  # noqa: E731
    monkeypatch.setattr(posterior_module.importlib.util, "find_spec", gone)
    refusal = drft("fit", log, "--posterior").refusal
    assert refusal == "a posterior needs BlackJAX: pip install 'drftjax[posterior]'"


def test_python_call_draws_when_asked(log, model):
    result = drftjax.fit([log], read_setup(model), [own("zeta")], posterior=FEW)
    assert result.posterior is not None
    assert result.posterior.draws.shape == (4, 20, 1)
