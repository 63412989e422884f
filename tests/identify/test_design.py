"""Designing a run: what it would tell is what fits to it scatter by, and limits are kept."""

import dataclasses
import hashlib
import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.common.rich_text import table_cells
from drftjax.physics.stress import Sharp
from drftjax.results.provenance import command_provenance, read_result_document
from drftjax.setups.setup import CommandSetUp, SetUp, WheelSetUp, read_setup
from identify.commands.design import _write
from identify.design.design import design, evaluate_setup, search_objective, trapezoid
from identify.design.fisher_information import (
    CHANNELS,
    InstrumentNoise,
    Objective,
    SpeedProfile,
    information,
    log_error,
    parameter_information,
    parameter_scales,
    sensitivities,
    value_and_gradient,
    with_gradient,
)
from identify.design.limits import Limits
from identify.design.report import design_document, design_table, design_toml
from identify.design.search import DesignSettings
from identify.parameters.parameter import parameter
from tests.helpers.drft_command import Drft
from tests.studies.design import fitted

PAPER = Path(__file__).parents[2] / "data" / "paper.toml"

# Corners of the step: plates that enter the sand or begin to lead as the parameter changes, where a
# derivative's growth is bounded: up to 0.2 % of it.
CORNERS = 2e-3
# Four runs tell a standard deviation to two fifths; twice that either way.
SCATTER = (0.2, 1.9)
# Differences over 0.001 still see plates that enter between one step and the next; the load's moves
# all of them at once.
SLOPES = 5e-3
# The logarithm of a standard error with rounded corners is another one by some percent.
ROUNDED = 0.05
# Ways and speeds that meet their limits do so but for a few roundings; in a file, speeds are sums.
ROUNDING = 1e-12
# Of the 8000 steps of these runs some hundreds of numbers each would be kept, with every tangent:
# gigabytes. Their rows take half a megabyte.
RECORD = 10e6

LIMITS = Limits(math.radians(80), math.radians(50), 4.0)
SMALL = DesignSettings(knots=3, starts=1, steps=1, scan=2, plate_size=0.008)


def given(peak: float = 30.0) -> SetUp:
    limits = Limits(LIMITS.speed, LIMITS.acceleration, LIMITS.duration)
    command = trapezoid(limits, WheelSetUp().radius, math.radians(peak))
    return SetUp(command, wheel=WheelSetUp(plate_size=0.008), title="a short run")


def test_sensitivities_and_information_are_those_of_central_differences():
    setup = given(80.0)
    setup.integrator.step = 2.5e-4
    trial = setup.trial()
    quantities = [parameter(name, shared=True).quantity for name in ("lambda", "zeta")]
    scale = jnp.asarray(parameter_scales(trial, quantities))
    exact = eqx.filter_jit(lambda t: sensitivities(t, quantities, scale))(trial)
    run = eqx.filter_jit(lambda t: t.run())

    columns = []
    for quantity, size, step in zip(quantities, scale, (3e-3, 1e-7), strict=True):
        ends = [
            run(quantity.write(trial, quantity.read(trial) + sign * step * size))
            for sign in (1, -1)
        ]
        ahead, behind = (jnp.stack([end.x, end.z]) for end in ends)
        columns.append((ahead - behind) / (2 * step))
    differences = jnp.stack(columns, axis=2)

    weight, counts = jnp.array([1 / 5e-5, 1 / 2e-5]), jnp.ones(exact.shape[1])
    by_derivatives = information(exact[:2], weight, counts)
    by_differences = information(differences, weight, counts)
    assert np.asarray(by_derivatives) == pytest.approx(np.asarray(by_differences), rel=CORNERS)
    assert float(log_error(by_derivatives)) == pytest.approx(
        float(log_error(by_differences)), abs=CORNERS
    )
    told = parameter_information(
        np.asarray(exact),
        InstrumentNoise().weight(),
        np.asarray(counts),
        quantities,
        1.1,
        float(scale[0]),
    )
    assert math.log(told.error / told.value) == pytest.approx(float(log_error(by_derivatives)))


def test_slopes_of_the_search_are_those_of_differences_and_point_where_the_models_do():
    objective = search_objective(given(), "lambda", ["zeta"], limits=LIMITS, search=SMALL)
    corners = lambda o: o.trial.simulator.terrain.law.corners  # noqa: E731
    sharp = eqx.tree_at(corners, objective, Sharp())
    at = jnp.asarray([0.5, 1.0, 0.5, 0.0])
    value = eqx.filter_jit(lambda objective, at: objective(at))

    def differences(objective: Objective, width: float) -> np.ndarray:
        ends = [
            [value(objective, at + way * step) for way in (1, -1)] for step in width * np.eye(4)
        ]
        return np.array([float(ahead - behind) for ahead, behind in ends]) / (2 * width)

    here, slope = eqx.filter_jit(value_and_gradient)(objective, at)
    assert float(here) == pytest.approx(float(value(objective, at)))
    assert np.asarray(slope) == pytest.approx(differences(objective, 1e-3), abs=SLOPES)
    assert float(here) == pytest.approx(float(value(sharp, at)), abs=ROUNDED)
    knots = np.asarray(slope)[:3]
    assert knots == pytest.approx(differences(sharp, 0.1)[:3], abs=ROUNDED)


def test_a_search_keeps_no_record_of_the_steps_of_a_run():
    objective = search_objective(given(), "lambda", ["zeta"], limits=LIMITS, search=SMALL)

    def slope(at: jax.Array) -> jax.Array:
        return jax.grad(lambda at: with_gradient(objective, at))(at)

    compiled = jax.jit(slope).lower(jnp.zeros(4)).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < RECORD


def test_fits_scatter_by_the_standard_error_that_was_promised():
    option = evaluate_setup(given(80.0), "lambda", ["zeta"])
    values = fitted(option.setup, seeds=4)
    assert SCATTER[0] < values.std(ddof=1) / option.information.error < SCATTER[1]
    # Three standard errors of a mean.
    assert abs(values.mean() - 1.1) < 3 * option.information.error / math.sqrt(len(values))


def test_another_run_of_the_same_wheel_compiles_nothing(compiled):
    slow = evaluate_setup(given(70.0), "lambda", ["zeta"])
    compiled.clear()
    fast = evaluate_setup(given(80.0), "lambda", ["zeta"])
    assert fast.information.error < slow.information.error
    assert not compiled


@pytest.mark.parametrize(
    "speed", [300, 100]
)  # beyond what so short a run gets to, and far under it
def test_every_profile_keeps_the_limits(speed):
    limits = Limits(math.radians(speed), math.radians(50), 24.0)
    profile = SpeedProfile(8, limits.speed, limits.acceleration, limits.duration, limits.rest)
    random = np.random.default_rng(1)
    for size in (0.1, 3.0, 30.0):
        omega = np.asarray(profile.omega(jnp.asarray(size * random.normal(size=8))))
        slope = np.diff(omega) / np.diff(profile.time)
        assert omega.min() >= 0
        assert omega.max() <= limits.speed + ROUNDING
        assert np.abs(slope).max() <= limits.acceleration + ROUNDING
        assert omega[[0, 1, -2, -1]].tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("travel", [0.05, 1.2, 100.0])
def test_no_run_goes_farther_than_the_rig(travel):
    limits = Limits(math.radians(300), math.radians(50), 24.0, travel=travel)
    radius = 0.15
    turn = travel / radius
    for peak in (10.0, 100.0, 300.0):
        command = trapezoid(limits, radius, math.radians(peak)).build()
        assert np.trapezoid(command.omega, command.time) <= turn * (1 + ROUNDING)
        assert np.diff(command.omega) / np.diff(command.time) == pytest.approx(
            [0, limits.acceleration, 0, -limits.acceleration, 0], abs=ROUNDING
        )
        assert command.time[-1] <= limits.duration
    profile = SpeedProfile(8, limits.speed, limits.acceleration, 10.0, limits.rest, turn)
    omega = profile.omega(jnp.asarray(3.0 * np.random.default_rng(1).normal(size=8)))
    assert np.trapezoid(omega, profile.time) <= turn * (1 + ROUNDING)
    # Far enough is no limit at all.
    fast = jnp.full(8, 5.0)
    free = SpeedProfile(8, limits.speed, limits.acceleration, 10.0, limits.rest).omega(fast)
    assert np.array_equal(profile.omega(fast), free) == (travel == 100.0)


def test_a_profile_within_reach_is_met_by_its_coordinates():
    profile = SpeedProfile(5, 5.0, 1.0, 20.0, 1.0)
    wanted = np.array([1.0, 2.5, 3.0, 2.0, 1.5])
    omega = profile.omega(jnp.asarray(profile.coordinates(wanted)))
    assert np.asarray(omega)[2:-2] == pytest.approx(wanted)


def test_a_designed_run_tells_more_and_is_a_set_up_file(tmp_path):
    found = design(given(), limits=LIMITS, search=SMALL)
    assert found.factor > 2
    assert found.parameter == "lambda"
    assert found.best.information.error == min(
        each.information.error for each in (*found.found, *found.scan)
    )
    # What a terminal would take for a tag of its own.
    of_length = table_cells(design_table(dataclasses.replace(found, unit="m")))
    assert of_length.title == "standard error of lambda [m], beside zeta"
    assert design_document(found)["schema"] == "drft-design"
    origin = command_provenance("design", [PAPER])
    path, numbers, _ = _write(found, tmp_path / "design", origin)
    assert path.read_text(encoding="utf-8").startswith(design_toml(found))
    document, kept = read_result_document(numbers)
    assert kept.provenance == origin
    assert origin.inputs[0].sha256 == hashlib.sha256(PAPER.read_bytes()).hexdigest()
    assert document["parameter"] == "lambda"
    command = read_setup(path).command.build()
    assert np.max(command.omega) <= LIMITS.speed + ROUNDING
    slope = np.diff(command.omega) / np.diff(command.time)
    assert np.abs(slope).max() <= LIMITS.acceleration + ROUNDING


def fast() -> SetUp:
    """A trapezoid whose rests are shorter than those of the search, and which tells the most."""
    setup, top = given(), math.radians(60)
    setup.command = CommandSetUp([0.0, 0.02, 1.22, 2.78, 3.98, 4.0], [0.0, 0.0, top, top, 0.0, 0.0])
    return setup


def test_a_designed_run_keeps_the_way_and_says_it():
    limits = dataclasses.replace(LIMITS, travel=0.08, speed=math.radians(50))
    found = design(fast(), limits=limits, search=SMALL)
    assert (
        max(each.rim_travel for each in (*found.found, *found.scan, *found.others))
        <= 0.08 + ROUNDING
    )
    # The speeds scanned are those that so short a way allows.
    assert found.peaks[-1] == max(found.scan[-1].setup.command.omega) < limits.speed
    assert (
        f"over {found.best.rim_travel:.3g} m of the rim (the given profile's is" in found.summary()
    )
    assert design_document(found)["best"]["way"] == found.best.rim_travel
    # However much the given one tells.
    speed, way = found.violations
    assert way == "its travel of 0.434 m is beyond 0.08 m"
    assert found.best is not found.given
    # A run that tells less is not called smaller.
    assert found.best.information.error > found.given.information.error
    told = found.summary()
    assert f"times larger, as the given profile cannot be run: {speed} and {way}" in told
    assert speed.startswith("its speed of")
    assert "is beyond 50 deg/s" in speed


def test_the_run_that_is_made_already_may_be_the_best():
    """A search that begins from trapezoids with longer rests does not find it."""
    limits = dataclasses.replace(LIMITS, speed=math.radians(60))
    found = design(fast(), limits=limits, search=SMALL)
    assert found.violations == ()
    assert found.best.information.error <= found.given.information.error


def test_a_width_that_scaling_factors_imitate_is_said_to_be_so():
    found = design(given(), "wheel.width", limits=LIMITS, search=SMALL)
    assert not found.identifiable
    assert "cannot be told from" in found.summary()
    assert "zeta" in found.summary()


def test_unknown_names_are_answered_with_near_ones():
    with pytest.raises(InputError, match=r"did you mean .*lambda"):
        design(given(), "lamda")
    with pytest.raises(InputError, match="nuisance as well"):
        design(given(), "lambda", nuisances=["lambda"])
    with pytest.raises(InputError, match="there is no channel 'y'"):
        design(given(), instrument=InstrumentNoise(channels=("y",)))


def test_a_driven_carriage_is_refused():
    setup = given()
    setup.rig.carriage = "driven"
    with pytest.raises(InputError, match="free carriage"):
        design(setup)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--max-speed", "-3"), "speed"),
        (("--max-speed", "nan"), "speed"),
        (("--max-acceleration", "50000"), "acceleration"),
        (("--duration", "0"), "duration"),
        (("--max-travel", "0"), "the largest travel is 0"),
        (("--loads", "220", "150"), "loads"),
        (("--noise-z", "0"), "noise of z is 0, must lie between 1e-09 and 1e+06 m"),
        (("--noise-torque", "0"), "noise of torque is 0, must lie between 1e-09 and 1e+06 N m"),
        (("--like", "run.h5"), "name one set-up file, or --like RUN, not both"),
        (("--wanted", "0"), "wanted"),
        (("--parameter", "lamda"), "lambda"),
        (("--channel", "y"), "channel"),
        (("-o", "."), "is a folder; name the result too"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(monkeypatch, capsys, tmp_path, arguments, said):
    path = tmp_path / "short.toml"
    path.write_text("[command]\ntime = [0, 1, 2]\nomega = [0, 0.1, 0]\n")
    assert said in Drft(monkeypatch, capsys)("design", path, *arguments).refusal


def test_a_zeta_at_knots_is_refused_in_one_sentence(monkeypatch, capsys, tmp_path):
    path = tmp_path / "knots.toml"
    path.write_text(
        "[terrain]\nzeta = {time = [0, 2], value = [0.78, 0.7]}\n"
        "[command]\ntime = [0, 1, 2]\nomega = [0, 0.1, 0]\n"
    )
    refusal = Drft(monkeypatch, capsys)("design", path).refusal
    assert refusal == "its terrain.zeta is 2 values over time, must be one number to be fitted"


def test_one_source_is_asked_for(monkeypatch, capsys):
    assert Drft(monkeypatch, capsys)("design").refusal == "name one set-up file, or --like RUN"


def test_channels_keep_their_order():
    weight = InstrumentNoise().weight("torque")
    assert [c for c, w in zip(CHANNELS, weight, strict=True) if w] == ["x", "z", "torque"]
