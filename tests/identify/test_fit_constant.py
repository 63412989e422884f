"""Fits of runs whose truth is known, and the machinery they stand on."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.stress import COEFFICIENT_NAMES
from drftjax.recorded.batch import device_mesh, make_batch
from drftjax.recorded.prepared_run import prepare_run
from drftjax.runlog.record import Measured, RecordedCommand
from identify.fit_constant import fit
from identify.parameters.bijector import Interval, Positive, Scaled
from identify.parameters.parameter import QUANTITIES, parameter
from identify.solver.levenberg_marquardt import structured_residual
from identify.solver.problem import Problem
from identify.uncertainty.noise_model import White
from tests.helpers.synthetic_runs import FAST, NOISE, SLOW, coarse, recorded, recut, setup_of

# Half the width of a 90 % interval, in standard errors of a normal distribution.
NINETY = 1.645

# The structured Jacobian and the plain one are the same sums in another order.
ROUNDING = 1e-10
# Central differences of a simulation with corners (docs/theory/integrator.md), at a change of 1e-7:
# a derivative has a bound on its growth where a plate turns over
# (`drftjax.simulation.simulator.LARGEST_GROWTH`), which takes 2.2 % off at this step.
DIFFERENCES = 3e-2
# The same derivatives by two compiled programs.
SAME_DERIVATIVES = 1e-4
# Compiled in two ways, a run that starts from rest agrees to some nanometres once it moves.
SAME_RUN = 1e-8
# Two fits of one run stop where a hundredth of a residual variance is left to gain
# (`identify.solver.levenberg_marquardt.NEGLIGIBLE`): a tenth of an error. What noise carries on
# from sample to sample is told of all runs of a fit together, by some hundred samples each.
SAME_FIT = 0.1
# A mean over the misfits of a few hundred samples that carry a part of one another; and the plates'
# and the step's own part beside the noise.
LEFT = 1.5
# There and back: a few roundings. Slopes by differences over 2e-6 of values up to 300, rounded.
BACK, BY_DIFFERENCES = 1e-13, 1e-7

ZETA, LAMBDA = "terrain.zeta", "terrain.inertial_coefficient"
OWN_ZETA = parameter("zeta", shared=False)
SHARED_ZETA = parameter("zeta", shared=True)
SHARED_LAMBDA = parameter("lambda", shared=True)

FAST_ZETAS = (0.72, 0.76)
DRAWBAR = 4.0
FORCE_NOISE = 0.2


def within_ninety(value, truth: float) -> bool:
    return abs(value.value - truth) <= NINETY * value.error


@pytest.fixture(scope="session")
def fast_fit():
    runs = {
        f"fast_{zeta}": recorded(setup_of(FAST, zeta), seed) for seed, zeta in enumerate(FAST_ZETAS)
    }
    candidates = [coarse(name, run) for name, run in runs.items()]
    return fit(candidates, [OWN_ZETA, SHARED_LAMBDA])


@pytest.fixture(scope="session")
def slow_runs():
    """Three slow runs that differ in length, sampling and sand."""
    longer = ([*SLOW[0], 1.9], [*SLOW[1], 0.7])
    return [
        recorded(setup_of(SLOW, 0.73), 1),
        recorded(setup_of(longer, 0.76), 2, rate=80.0),
        recorded(setup_of(SLOW, 0.79), 3, rate=20.0),
    ]


def test_fast_runs_give_zeta_and_lambda_within_their_ninety_percent_intervals(fast_fit):
    assert fast_fit.status == "converged"
    for run, zeta in zip(fast_fit.runs, FAST_ZETAS, strict=True):
        assert within_ninety(run.values[ZETA], zeta)
        # Fast runs tell zeta to less than a thousandth, and lambda to a twentieth.
        assert run.values[ZETA].error < 0.001 * zeta
        assert max(run.rmse().values()) < LEFT * NOISE
        assert run.rmse(fitted=False)["z"] > 5 * NOISE
    assert within_ninety(fast_fit.shared[LAMBDA], 1.1)
    assert fast_fit.shared[LAMBDA].error < 0.05


def test_papers_wheel_speed_says_nothing_of_lambda(fast_fit):
    # Scales that read to a tenth of a millimetre: the standard error is about 3, of a lambda of
    # 1.1; at eight times the speed it is under 0.05 even so. Noise is five times as large here.
    run = recorded(setup_of(SLOW, 0.75), 4, noise=1e-4)
    slow = fit([coarse("slow", run)], [OWN_ZETA, SHARED_LAMBDA])
    error = slow.shared[LAMBDA].error
    assert error > 1.1
    assert error > 50 * (1e-4 / NOISE) * fast_fit.shared[LAMBDA].error
    assert within_ninety(slow.shared[LAMBDA], 1.1)
    assert within_ninety(slow.runs[0].values[ZETA], 0.75)


def test_one_zeta_for_all_runs_and_a_drawbar_load_are_found():
    candidates = []
    for seed, profile in enumerate((SLOW, SLOW)):
        setup = setup_of(profile, 0.74)
        setup.rig.drawbar_load = DRAWBAR
        candidates.append(coarse(f"run_{seed}", recorded(setup, seed)))
    load = parameter("rig.drawbar_load", shared=False)
    result = fit(candidates, [SHARED_ZETA, load])
    assert within_ninety(result.shared[ZETA], 0.74)
    for run in result.runs:
        assert list(run.values) == ["rig.drawbar_load"]
        assert within_ninety(run.values["rig.drawbar_load"], DRAWBAR)
        # The slip of a wheel that rolls tells its pull to a twentieth.
        assert run.values["rig.drawbar_load"].error < 0.1 * DRAWBAR
        assert run.setup.rig.drawbar_load == run.values["rig.drawbar_load"].value
        assert run.setup.terrain.zeta == result.shared[ZETA].value


def test_driven_carriage_is_fitted_by_sinkage_and_forces():
    setup = setup_of(SLOW, 0.76, vx=[0.0, 0.0, 0.06, 0.06])
    run = recorded(setup, 5, channels=("x", "z", "fx", "fz"), force_noise=FORCE_NOISE)
    each = coarse("driven", run)
    assert each.observation.channels == ("z", "fx", "fz")
    result = fit([each], [OWN_ZETA])
    assert within_ninety(result.runs[0].values[ZETA], 0.76)
    fitted = result.runs[0]
    assert list(fitted.rmse()) == ["z", "fx", "fz"]
    # As the wheel breaks loose, fx tells the start's sinkage to a few micrometres.
    rolling = fitted.time > 0.4
    left = (fitted.after - fitted.recorded)[:, rolling].std(axis=1)
    assert np.all(left < 2 * np.array([NOISE, FORCE_NOISE, FORCE_NOISE]))


def test_runs_side_by_side_are_fitted_as_if_alone(slow_runs):
    candidates = [coarse(f"run_{k}", run) for k, run in enumerate(slow_runs[:2])]
    together = fit(candidates, [OWN_ZETA])
    beside, alone = together.runs[1], fit(candidates[1:], [OWN_ZETA]).runs[0]
    assert beside.name == alone.name
    ours, theirs = alone.values[ZETA], beside.values[ZETA]
    assert abs(ours.value - theirs.value) < SAME_FIT * ours.error
    assert ours.error == pytest.approx(theirs.error, rel=SAME_FIT)
    np.testing.assert_array_equal(beside.recorded, alone.recorded)
    np.testing.assert_array_equal(beside.counts, alone.counts)


# The batch --------------------------------------------------------------------------------------


def problem_of(candidates, parameters, multiple: int = 2) -> Problem:
    batch = make_batch([c.trial for c in candidates], [c.observation for c in candidates], multiple)
    return Problem(batch, tuple(parameters), White(), device_mesh())


@pytest.fixture(scope="session")
def slow_problem(slow_runs) -> Problem:
    candidates = [coarse(f"run_{k}", run) for k, run in enumerate(slow_runs)]
    return problem_of(candidates, [OWN_ZETA, SHARED_LAMBDA])


@eqx.filter_jit
def blocks_of(problem: Problem, shared, own):
    return problem.blocks(shared, own)


@eqx.filter_jit
def residual_of(problem: Problem, shared, own):
    return problem.residual(shared, own)


def flat(problem: Problem):
    """The problem as a function of one vector, and the vector of its start."""
    shared, own = problem.start()

    def parts(vector):
        return vector[: shared.size], vector[shared.size :].reshape(own.shape)

    return parts, jnp.concatenate([shared, own.ravel()])


def test_structured_jacobian_is_the_plain_one(slow_problem):
    parts, start = flat(slow_problem)

    @eqx.filter_jit
    def jacobian(function, at):
        return jax.jacfwd(function)(at)

    plain = jacobian(lambda v: slow_problem.residual(*parts(v)), start)
    rows = blocks_of(slow_problem, *parts(start))
    structured = jacobian(lambda v: structured_residual(rows, parts(v)), start)
    assert float(jnp.abs(plain).max()) > 1
    scale = float(jnp.abs(plain).max())
    assert float(jnp.abs(structured - plain).max()) < ROUNDING * scale


def test_jacobian_meets_central_differences(slow_problem):
    shared, own = slow_problem.start()
    _, blocks = blocks_of(slow_problem, shared, own)
    # So small a change crosses none of the corners where plates begin to lead.
    change = 1e-7
    for column, direction in enumerate([(1.0, 0.0), (0.0, 1.0)]):
        ahead, behind = (
            residual_of(slow_problem, shared + s * direction[0], own + s * direction[1])
            for s in (change, -change)
        )
        differences = (ahead - behind) / (2 * change)
        derivative = blocks[..., column]
        # Where the recordings count, and relative to the whole run's derivative.
        off = jnp.sqrt(jnp.sum((differences - derivative) ** 2) / jnp.sum(derivative**2))
        assert float(off) < DIFFERENCES


def test_padding_to_a_number_of_devices_changes_nothing(slow_runs, slow_problem):
    assert slow_problem.batch.runs == 3
    padded = slow_problem.batch.observed.weight
    assert padded.shape[0] == 4
    assert not np.any(padded[3])
    residual, blocks = blocks_of(slow_problem, *slow_problem.start())
    assert not np.any(residual[3])
    assert not np.any(blocks[3])
    alone = problem_of([coarse("run_1", slow_runs[1])], [OWN_ZETA, SHARED_LAMBDA])
    bare, bare_blocks = blocks_of(alone, *alone.start())
    time = slow_runs[1].measured.time
    # Both compiled programs may take the first step from rest differently, by a rounding.
    moving = np.flatnonzero(time > 0.5)
    metres = (residual[1][:, moving] - bare[0][:, moving]) / (
        np.asarray(alone.batch.observed.weight)[0][:, moving]
    )
    assert np.abs(metres).max() < SAME_RUN
    np.testing.assert_allclose(
        blocks[1][:, moving],
        bare_blocks[0][:, moving],
        rtol=0,
        atol=SAME_DERIVATIVES * np.abs(bare_blocks).max(),
    )


def test_shorter_runs_are_padded_with_samples_that_weigh_nothing(slow_runs, slow_problem):
    weight = np.asarray(slow_problem.batch.observed.weight)
    for run, row in zip(slow_runs, weight, strict=False):
        assert np.all(row[:, : len(run.measured.time)] > 0)
        assert not np.any(row[:, len(run.measured.time) :])


# Runs that cannot be fitted ---------------------------------------------------------------------


def test_odd_runs_are_named_and_the_others_fitted(slow_runs):
    good = [coarse(f"run_{k}", run) for k, run in enumerate(slow_runs[:2])]
    grouserless = dataclasses.replace(slow_runs[0].setup, grouser_count=0)
    plain = coarse("plain", dataclasses.replace(slow_runs[0], setup=grouserless))
    finer = recut(prepare_run("finer", slow_runs[0]), 0.004)
    hard = coarse("no_sand", slow_runs[0], zeta=0.0)
    result = fit([plain, good[0], finer, good[1], hard], [OWN_ZETA])
    assert [run.name for run in result.runs] == ["run_0", "run_1"]
    assert set(result.failures) == {"plain", "finer", "no_sand"}
    assert "has another kind of wheel" in result.failures["plain"]
    assert (
        result.failures["no_sand"] == "its terrain.zeta is 0, where no fit within its bounds starts"
    )


def test_as_many_runs_of_two_wheels_are_refused(slow_runs):
    """No order in which they were named says which of the two is meant."""
    grouserless = dataclasses.replace(slow_runs[0].setup, grouser_count=0)
    plain = coarse("plain", dataclasses.replace(slow_runs[0], setup=grouserless))
    for runs in ([plain, coarse("run", slow_runs[0])], [coarse("run", slow_runs[0]), plain]):
        with pytest.raises(InputError, match=r"of different wheels.*\((plain; run|run; plain)\)"):
            fit(runs, [OWN_ZETA])


def test_runs_without_the_number_to_be_fitted_are_named(slow_runs):
    grouserless = dataclasses.replace(slow_runs[0].setup, grouser_count=0)
    plain = coarse("plain", dataclasses.replace(slow_runs[0], setup=grouserless))
    with pytest.raises(InputError, match=r"no run is left to fit \(plain: .*grouser_height"):
        fit([plain], [parameter("wheel.grouser_height", shared=True)])


def test_two_runs_of_one_name_are_refused(slow_runs):
    twins = [coarse("twin", slow_runs[0]), coarse("twin", slow_runs[1])]
    with pytest.raises(InputError, match="twin"):
        fit(twins, [OWN_ZETA])


def test_no_runs_are_refused():
    with pytest.raises(InputError, match="no run is left to fit"):
        fit([], [OWN_ZETA])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"measured": Measured(time=[0.0, 1.0], torque=[0.0, 1.0])}, "has none of x, z"),
        ({"command": RecordedCommand(time=[0.0, 1.0], omega=[0.0, 0.0])}, "never moves the wheel"),
        ({"measured": Measured(time=[5.0, 6.0], z=[0.0, 0.0])}, "no sample lies within"),
    ],
)
def test_run_that_shows_nothing_is_refused_by_name(slow_runs, change, said):
    run = dataclasses.replace(slow_runs[0], **change)
    with pytest.raises(InputError, match=f"^run_7: .*{said}"):
        prepare_run("run_7", run)


# What is compared, and the numbers behind -------------------------------------------------------


def test_candidate_starts_where_the_recording_does(slow_runs):
    each = prepare_run("run", slow_runs[0])
    early = slow_runs[0].measured.time <= 0.2 + 1e-9
    assert each.setup.start.sinkage == pytest.approx(-slow_runs[0].measured.z[early].mean())
    assert each.setup.start.x == pytest.approx(slow_runs[0].measured.x[early].mean())
    assert prepare_run("run", slow_runs[0], zeta=0.6).setup.terrain.zeta == 0.6
    assert prepare_run("run", slow_runs[0], step=5e-4).setup.integrator.step == 5e-4
    with pytest.raises(InputError, match="integrator step is 0"):
        prepare_run("run", slow_runs[0], step=0.0)


@pytest.mark.parametrize(
    ("bijector", "values"),
    [
        (Positive(), [1e-6, 0.7, 300.0]),
        (Scaled(10.0), [-3.0, 0.0, 40.0]),
        (Interval(-20.0, 50.0), [-19.9, 1.1, 49.9]),
    ],
)
def test_bijectors_go_there_and_back_with_their_slope(bijector, values):
    values = jnp.asarray(values)
    coordinates = bijector.coordinate(values)
    np.testing.assert_allclose(bijector.value(coordinates), values, rtol=BACK)
    ahead, behind = bijector.value(coordinates + 1e-6), bijector.value(coordinates - 1e-6)
    np.testing.assert_allclose(
        bijector.slope(coordinates), (ahead - behind) / 2e-6, rtol=BY_DIFFERENCES
    )


def test_unknown_parameter_shows_the_nearest():
    with pytest.raises(InputError, match=r"no parameter 'zeto'; did you mean zeta"):
        parameter("zeto", shared=True)
    with pytest.raises(InputError, match=r"did you mean rig\.mass_z"):
        parameter("rig.mass", shared=True)
    with pytest.raises(InputError, match=r"terrain\.zeta"):
        parameter("qqqqqqq", shared=True)


@pytest.mark.parametrize(
    ("name", "known", "said"),
    [
        ("lambda", {"start": 100.0}, "lambda starts at 100, outside its bounds -20 to 50"),
        ("zeta", {"bounds": (0.3, np.inf)}, "zeta are 0.3 to inf; both must be finite"),
        ("zeta", {"bounds": (0.9, 0.3)}, "zeta are 0.9 to 0.3; the first must be less"),
        ("zeta", {"bounds": (0.3, 0.9), "start": 1.0}, "outside its bounds 0.3 to 0.9"),
        ("zeta", {"start": 0.0}, "zeta starts at 0, must be positive"),
        ("zeta", {"start": np.inf}, "zeta starts at inf, must be positive and finite"),
    ],
)
def test_bounds_and_starts_that_cannot_be_are_said_as_they_were_given(name, known, said):
    with pytest.raises(InputError, match=said):
        parameter(name, shared=True, **known)


def test_bounds_that_leave_the_set_up_out_are_shown(slow_runs):
    bounded = parameter("zeta", shared=True, bounds=(1.0, 2.0))
    said = r"its terrain\.zeta is 0\.7823, outside the bounds 1 to 2; give a start within them"
    with pytest.raises(InputError, match=said):
        fit([coarse("run", slow_runs[0])], [bounded])


def test_a_stress_coefficient_is_found_beside_each_runs_zeta(slow_runs):
    candidates = [coarse(f"run {n}", run) for n, run in enumerate(slow_runs)]
    result = fit(candidates, [OWN_ZETA, parameter("B11", shared=True, start=0.18)])
    value = result.shared["terrain.coefficients.B11"]
    assert (value.label, value.unit) == ("B11", "N/cm3")
    assert value.identified
    assert within_ninety(value, 0.212)
    listed = result.runs[0].setup.terrain.coefficients
    assert listed[COEFFICIENT_NAMES.index("B11")] == value.value
    assert result.runs[0].setup.trial()  # and a list of nine builds again


@pytest.mark.parametrize("name", QUANTITIES)
def test_every_quantity_is_read_and_written_in_its_place(name):
    trial = setup_of().trial()
    quantity = QUANTITIES[name]
    value = quantity.read(trial)
    changed = quantity.write(trial, value + 0.5)
    assert float(quantity.read(changed)) == float(value) + 0.5
    others = [n for n, q in QUANTITIES.items() if float(q.read(changed)) != float(q.read(trial))]
    assert others == [name]


def test_every_quantity_is_in_the_documentation_and_in_a_set_up():
    page = (Path(__file__).resolve().parents[2] / "docs" / "guide" / "fit.md").read_text()
    setup = setup_of()
    for name, quantity in QUANTITIES.items():
        assert f"`{name}`" in page
        quantity.record(setup, 0.25)
        section, field, *element = name.split(".")
        recorded = getattr(getattr(setup, section), field)
        assert (recorded[COEFFICIENT_NAMES.index(*element)] if element else recorded) == 0.25
