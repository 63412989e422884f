"""Numbers beside the zeta(t) of each run: what a path could do as well tells nothing of them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.setups.setup import add_fitted_effects
from identify.fit_path import fit_paths
from identify.fit_path_jointly import JointFit, _JointProblem, fit_jointly
from identify.parameters.parameter import own, shared
from identify.zeta_path.path import cardinal_splines
from tests.identify.test_zeta_path import made
from tests.studies.crosscheck import NOISE

LAMBDA = "terrain.inertial_coefficient"
TRUE_LAMBDA = 1.1
STEP = 1e-3
TIME = (0.0, 0.2, 1.7, 2.1, 3.6, 3.8)
KNOTS = np.linspace(0.0, 3.6, 5)
SPACING = KNOTS[1]
# Half the width of a 90 % interval, in standard errors of a normal distribution; two such values
# and a few knots lie within three of them but once in many hundred times.
NINETY, FAR = 1.645, 3.0
# Sums of the same products in another order, of numbers that differ by eight orders: eight of a
# double's sixteen digits may go.
ROUNDING = 1e-8
# The root mean square of the 170 samples of a moving wheel scatters by 1 / sqrt(2 * 170), a
# twentieth; five times that.
MISFIT = 0.25
# Where a fit stops, in standard errors: `identify.fit_path_jointly.SMALL_MOVE`, and its last move.
STOPS = 0.2
DRAWBAR = (2.0, 5.0)
PRIOR = (1.4, 0.05)
# So slow a run tells lambda to five at the best: of an error of 0.05 that takes 5e-5.
PRIORS_OWN = 1e-4
# A value within a thousandth of its interval is at a bound (`identify.parameters.parameter`).
BOUNDS = (0.2, 0.6)
AT_BOUND = 1e-3 * (BOUNDS[1] - BOUNDS[0])


def wave(number: int):
    """A zeta(t) that the knots draw."""
    values = 0.75 + 0.03 * np.sin(2.0 * KNOTS + number)
    return lambda t: np.exp(cardinal_splines(KNOTS, np.asarray(t)) @ np.log(values))


def run(number: int, top: float, step: float = STEP, **changed) -> PreparedRun:
    """A run up to so many deg/s and down again."""
    omega = (0.0, 0.0, top, top, 0.0, 0.0)
    return made(f"run {number}", wave(number), 20 + number, TIME, omega, step=step, **changed)


@pytest.fixture(scope="module")
def runs() -> list[PreparedRun]:
    return [run(number, 80.0) for number in range(2)]


@pytest.fixture(scope="module")
def found(runs) -> JointFit:
    """From a lambda that is far off."""
    return fit_jointly(runs, [shared("lambda", start=0.2)], SPACING)


def test_lambda_and_zeta_over_time_come_back_together(runs, found):
    (value,) = found.values[0].values()
    assert found.converged
    # Two runs up to 80 deg/s tell it to a twelfth of itself.
    assert value.error < 0.1 * TRUE_LAMBDA
    assert abs(value.value - TRUE_LAMBDA) < FAR * value.error
    for number, each in enumerate(found.solvers):
        path = each.path()
        away = (path.value - wave(number)(path.time)) / path.error
        assert np.abs(away[path.identified]).max() < FAR
        assert path.rmse["z"] == pytest.approx(NOISE, rel=MISFIT)
        assert path.rmse["x"] == pytest.approx(NOISE, rel=MISFIT)


def test_what_is_found_does_not_depend_on_the_start(runs, found):
    again = fit_jointly(runs, [shared("lambda")], SPACING)
    one, other = (each.values[0][LAMBDA] for each in (found, again))
    assert abs(one.value - other.value) < STOPS * one.error


def test_errors_are_those_of_all_coordinates_together(runs, found):
    """The Schur complement against the inverse of the whole matrix, paths and all."""
    fit = _JointProblem(found.runs, [shared("lambda")])
    linear = fit.linearize(found.coordinates, found.solvers)
    size = sum(each.path for each in linear)
    whole = np.zeros((size + 1, size + 1))
    first = 0
    for each in linear:
        place = np.r_[first : first + each.path, size]
        whole[np.ix_(place, place)] += each.information
        first += each.path
    covariance = np.linalg.inv(whole)
    assert found.covariance[0, 0] == pytest.approx(covariance[-1, -1], rel=ROUNDING)
    path = found.solvers[0]
    knots = np.diag(covariance)[: path.knots]
    assert np.diag(path.posterior.covariance)[: path.knots] == pytest.approx(knots, rel=ROUNDING)


def pulled(number: int, force: float) -> PreparedRun:
    """A run that a drawbar pulls back, and its set-up knows of drawbars."""
    each = run(number, 20.0, STEP, effects=[{"name": "drawbar", "force": force}])
    add_fitted_effects(each.setup, ["drawbar.force"])
    return dataclasses.replace(each, trial=each.setup.trial(10 * STEP))


def test_each_run_may_have_a_number_of_its_own():
    runs = [pulled(number, force) for number, force in enumerate(DRAWBAR)]
    result = fit_paths(runs, SPACING, [own("drawbar.force")])
    assert result.status == "converged"
    assert result.labels == ("drawbar.force of run 0", "drawbar.force of run 1")
    for each, force in zip(result.runs, DRAWBAR, strict=True):
        value = each.values["drawbar.force"]
        assert value.identified
        assert abs(value.value - force) < FAR * value.error
        (effect,) = each.setup.effects
        assert effect["force"] == value.value
    error = np.sqrt(np.diag(result.covariance))
    assert error == pytest.approx([v.error for v in result.values.values()], rel=ROUNDING)
    assert "drawbar.force" in result.summary()


def test_a_prior_holds_what_the_runs_do_not_tell():
    slow = run(3, 5.0, STEP)
    untold = fit_paths([slow], SPACING, [shared("lambda")])
    assert not untold.shared[LAMBDA].identified
    assert any("lambda cannot be identified" in each for each in untold.findings)
    believed = fit_paths([slow], SPACING, [shared("lambda", prior=PRIOR)])
    value = believed.shared[LAMBDA]
    assert value.error == pytest.approx(PRIOR[1], rel=PRIORS_OWN)
    assert abs(value.value - PRIOR[0]) < STOPS * PRIOR[1]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("zeta", "zeta is what a path is of"),
        ("zeta.steady", "zeta.steady is what a path is of"),
        ("start.sinkage", "each path finds its own start.sinkage"),
    ],
)
def test_what_a_path_finds_itself_is_refused(runs, name, said):
    with pytest.raises(InputError, match=said):
        fit_paths(runs, SPACING, [own(name)])


def test_a_value_at_its_bound_is_said_to_be_and_a_run_outside_is_left_out():
    runs = [run(number, 45.0, STEP) for number in range(2)]
    write = shared("lambda").quantity.write
    within, beyond = (
        dataclasses.replace(each, trial=write(each.trial, jnp.asarray(value)))
        for each, value in zip(runs, (0.4, 3.0), strict=True)
    )
    bounded = own("lambda", bounds=BOUNDS)
    result = fit_paths([within, beyond], SPACING, [bounded])
    assert [each.name for each in result.runs] == ["run 0"]
    assert "outside the bounds 0.2 to 0.6" in result.failures["run 1"]
    assert result.runs[0].values[LAMBDA].value == pytest.approx(BOUNDS[1], abs=AT_BOUND)
    assert result.runs[0].status == "at a bound"
    assert any(f.startswith("lambda has run into its bound") for f in result.findings)
