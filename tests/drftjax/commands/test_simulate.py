"""`drft simulate`: a set-up, a recorded run or a fitted model in; a run log and a figure out."""

import os
from pathlib import Path

import equinox as eqx
import h5py
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.check import check_file
from drftjax.runlog.hdf5.api import read_run, write_result
from drftjax.setups.command_knots import decimate_command
from drftjax.setups.fitted_model import FIT_SCHEMA
from drftjax.setups.from_run import setup_from_run
from drftjax.setups.setup import CommandSetUp, SetUp, WheelSetUp, read_setup
from drftjax.setups.simulated_run import simulated_run
from drftjax.simulation.trial import check_output
from tests.helpers.drft_command import Drft

DATA = Path(__file__).parents[3] / "data"
PAPER = DATA / "paper.toml"

# docs/theory/model.md gives these with three or four digits: half a unit of the last one.
SETTLED_MM, PLACE_M = 0.05, 0.0005

# What a user may rely on against an independent implementation: a tenth of a millimetre of
# sinkage, two millimetres of travel.
SINKAGE_RMSE, TRAVEL = 1e-4, 2e-3

# Rows 2.5 ms apart, joined by straight lines, against steps of 0.5 ms, in a run whose wheel
# ripples at some Hz by less than a millimetre.
INTERPOLATION = 1e-5

# Half the default step moves a run by about its own error, a few micrometres; never by nothing.
STEP_EFFECT = 5e-5

# A clock of 24 s is a sum of 48,000 steps, each rounded to 1e-16 of it.
CLOCK = 1e-10
# The same operations, compiled in two ways; and places that are summed from speeds.
ROUNDING = 1e-12

SHORT = """
title = "a short run"
[wheel]
shape = "plain"
plate_size = 0.02
[command]
time = [0, 0.2, 0.5, 1.0]
omega = [0, 0, 1, 1]
"""
SOFT = "[terrain]\nzeta = 0.05\n" + SHORT.split("\n", 2)[2]


@pytest.fixture
def short(tmp_path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


def rmse(a, b) -> float:
    return float(np.sqrt(np.mean((np.asarray(a) - np.asarray(b)) ** 2)))


def test_papers_run_meets_the_models_numbers_and_reads_back(drft, tmp_path):
    log, picture = tmp_path / "new" / "folder" / "paper.h5", tmp_path / "paper.png"
    answer = drft("simulate", PAPER, "-o", log, "--plot", picture)
    assert answer.code == 0
    assert "24 s" in answer.out
    assert str(log) in answer.out
    assert not check_file(log)
    run = read_run(log)
    time, z, x = run.measured.time, run.measured.z, run.measured.x
    assert time[-1] == pytest.approx(24, abs=CLOCK)
    assert 1e3 * np.interp(2.0, time, z) == pytest.approx(-17.6, abs=SETTLED_MM)
    assert x[-1] - x[0] == pytest.approx(1.169, abs=PLACE_M)
    assert set(run.measured.channels()) == {"x", "z", "fx", "fz", "torque"}
    assert run.source == "simulated"
    assert run.software == "drftjax"
    assert run.setup.scaling_factor_initial == 0.7823
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["paper", "fast_300deg", "plain_wheel"])
def test_like_a_reference_run_meets_it_at_its_own_times(drft, shared, tmp_path, name):
    source, log = shared / "reference_rigs" / f"{name}.h5", tmp_path / "again.h5"
    assert drft("simulate", "--like", source, "-o", log).code == 0
    recorded, again = read_run(source).measured, read_run(log).measured
    np.testing.assert_array_equal(again.time, recorded.time)
    assert rmse(again.z, recorded.z) < SINKAGE_RMSE
    assert abs(again.x[-1] - recorded.x[-1]) < TRAVEL


def test_like_a_simulated_run_gives_it_again(drft, short, tmp_path):
    # A run log does not say how finely its wheel was cut.
    short.write_text(SHORT.replace("plate_size = 0.02", ""))
    first, again = tmp_path / "first.h5", tmp_path / "again.h5"
    drft("simulate", short, "-o", first, "--rate", "400")
    assert drft("simulate", "--like", first, "-o", again).code == 0
    recorded, twin = read_run(first).measured, read_run(again).measured
    assert rmse(twin.z, recorded.z) < INTERPOLATION
    assert rmse(twin.x, recorded.x) < INTERPOLATION


def test_a_run_lasts_as_long_whenever_it_begins(drft, short):
    short.write_text(SHORT.replace("time = [0, 0.2, 0.5, 1.0]", "time = [5, 5.2, 5.5, 6]"))
    answer = drft("simulate", short)
    assert answer.code == 0
    assert "a short run: 1 s, deepest sinkage" in answer.out


def test_rows_at_uneven_times_are_those_of_the_run(short):
    setup = read_setup(short)
    times = np.sort(np.random.default_rng(1).uniform(0, 1, 40))
    uneven = simulated_run(setup, at=times).measured
    full = simulated_run(setup, 2.5e-3).measured
    np.testing.assert_array_equal(uneven.time, times)
    assert rmse(uneven.z, np.interp(times, full.time, full.z)) < INTERPOLATION
    assert rmse(uneven.x, np.interp(times, full.time, full.x)) < INTERPOLATION


@pytest.mark.parametrize("carriage", ["", "vx = [0, 0, 0.1, 0.1]\n[rig]\ncarriage = 'driven'\n"])
def test_past_its_commands_end_a_run_goes_on_as_it_was_last_told(short, carriage):
    short.write_text(SHORT + carriage)
    beyond = read_setup(short)
    longer = SHORT + carriage.replace("0.1]", "0.1, 0.1]")
    longer = longer.replace("0.5, 1.0]", "0.5, 1.0, 2.0]").replace("1, 1]", "1, 1, 1]")
    short.write_text(longer)
    times = np.linspace(0.0, 2.0, 41)
    held, written = simulated_run(beyond, at=times), simulated_run(read_setup(short), at=times)
    np.testing.assert_array_equal(held.measured.x, written.measured.x)
    np.testing.assert_array_equal(held.measured.z, written.measured.z)
    # A second more at 0.1 m/s or 1 rad/s.
    assert held.measured.x[-1] > held.measured.x[20] + 0.05
    assert held.command.time[-1] == 1.0


def final(drft: Drft, folder: Path, *arguments: object):
    log = folder / "log.h5"
    answer = drft("simulate", *arguments, "-o", log)
    assert answer.code == 0, answer
    return read_run(log)


def test_zeta_and_lambda_on_the_command_line_outrank_the_set_up(drft, short, tmp_path):
    plain = final(drft, tmp_path, short)
    softer = final(drft, tmp_path, short, "--zeta", "0.5")
    lighter = final(drft, tmp_path, short, "--lambda", "0")
    written = read_setup(short)
    written.terrain.zeta = 0.5
    assert softer.setup.scaling_factor_initial == 0.5
    np.testing.assert_array_equal(softer.measured.z, simulated_run(written).measured.z)
    written = read_setup(short)
    written.terrain.inertial_coefficient = 0.0
    np.testing.assert_array_equal(lighter.measured.z, simulated_run(written).measured.z)
    # 25 mm a zeta, or more: 7 mm at the least.
    assert softer.measured.z[-1] < plain.measured.z[-1] - 7e-3
    assert rmse(lighter.measured.z, plain.measured.z) > 0


def test_a_speed_that_is_likely_of_another_unit_is_noted(drft, short):
    """A command in deg/s whose unit was left out: the run is simulated as written, and said."""
    short.write_text(SHORT.replace("[0, 0, 1, 1]", "[0, 0, 30, 30]"))
    answer = drft("simulate", short)
    assert answer.code == 0
    assert "note: /command/omega reaches 30 rad/s" in answer.err
    assert "perhaps these are deg/s" in answer.err
    short.write_text(SHORT)
    assert "note" not in drft("simulate", short).err


def test_step_and_rate_say_how_finely(drft, short, tmp_path):
    plain = final(drft, tmp_path, short).measured
    finer = final(drft, tmp_path, short, "--step", "2.5e-4").measured
    assert len(plain.time) == len(finer.time) == 101
    assert 0 < rmse(finer.z, plain.z) < STEP_EFFECT
    sparse = final(drft, tmp_path, short, "--rate", "20").measured
    np.testing.assert_allclose(np.diff(sparse.time), 0.05, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(sparse.z, plain.z[::5], rtol=0, atol=ROUNDING)


def test_rows_come_at_whole_steps_and_the_command_says_so(drft, short):
    answer = drft("simulate", short, "--step", "5e-4", "--rate", "1500")
    assert "note: rows come at 2000 Hz, at whole steps" in answer.err
    assert "note" not in drft("simulate", short, "--step", "5e-4", "--rate", "400").err
    # A step that is chosen divides the rows.
    assert "note" not in drft("simulate", short, "--rate", "1500").err
    assert drft("simulate", short, "--rate", "1").code == 0


def test_run_ends_with_its_command_where_rows_do_not_divide_it(drft, short, tmp_path):
    short.write_text(SHORT.replace("0.5, 1.0", "0.5, 0.999"))
    time = final(drft, tmp_path, short, "--rate", "100").measured.time
    # The last row of 10 ms that lies in it.
    assert time[-1] == pytest.approx(0.99, abs=CLOCK)


def test_command_that_starts_late_keeps_its_clock(drft, short, tmp_path):
    at_zero = final(drft, tmp_path, short).measured
    short.write_text(SHORT.replace("[0, 0.2, 0.5, 1.0]", "[5, 5.2, 5.5, 6.0]"))
    late = final(drft, tmp_path, short)
    np.testing.assert_allclose(late.measured.time, at_zero.time + 5, rtol=0, atol=CLOCK)
    np.testing.assert_allclose(late.measured.z, at_zero.z, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(late.command.time, [5, 5.2, 5.5, 6])


def test_driven_carriage_goes_where_it_is_told(drft, short, tmp_path):
    driven = SHORT + "vx = [0, 0, 0.1, 0.1]\n[rig]\ncarriage = 'driven'\n"
    short.write_text(driven)
    run = final(drft, tmp_path, short)
    np.testing.assert_array_equal(run.command.vx, [0, 0, 0.1, 0.1])
    # The knots' trapezia.
    assert run.measured.x[-1] == pytest.approx(0.015 + 0.05, abs=ROUNDING)
    first = (tmp_path / "log.h5").rename(tmp_path / "first.h5")
    again = final(drft, tmp_path, "--like", first)
    assert again.measured.x[-1] == pytest.approx(run.measured.x[-1], abs=ROUNDING)


# Refusals ---------------------------------------------------------------------------------------


def test_one_source_is_asked_for(drft, short, tmp_path):
    assert drft("simulate").refusal.startswith("no sources were given; name one set-up file")
    like = DATA / "runs" / "fast.h5"
    assert drft("simulate", short, "--like", like).refusal.startswith("2 sources were given")
    assert drft("simulate", short, "--like", like, "--from", like).refusal.startswith("3 sources")
    assert "--run goes with --from" in drft("simulate", short, "--run", "a").refusal
    assert "--run goes with --from" in drft("simulate", "--like", like, "--run", "a").refusal


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rate", "0"], "--rate is 0 Hz, must be above 0 and at most 100000 Hz"),
        (["--rate", "nan"], "--rate is nan Hz, must be above 0 and at most"),
        (["--rate", "0.5"], "rows 2 s apart are farther than the command lasts (1 s)"),
        (["--rate", "1e-7"], "rows 1e+07 s apart are farther than the command lasts (1 s)"),
        (["--step", "0"], "integrator step is 0, must lie between"),
        (["--step", "nan"], "integrator step is nan, must lie between"),
        (["--zeta", "-1"], "zeta is -1, must lie between"),
        (["--lambda", "-21"], "inertial coefficient (lambda) is -21, must lie between"),
        (["-o", "run.txt"], "run.txt: a run log's name must end in .h5, .hdf5"),
        (["-o", "run"], "run: a run log's name must end in .h5, .hdf5"),
        (["--plot", "run.jpeg2000"], "run.jpeg2000: a figure's name must end in .png, .pdf, .svg"),
    ],
)
def test_numbers_and_names_that_cannot_be_are_refused(
    drft, short, tmp_path, monkeypatch, arguments, said
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    answer = drft("simulate", short, *arguments)
    assert said in answer.refusal
    assert answer.out == ""  # nothing was simulated before
    assert sorted(tmp_path.iterdir()) == before


def test_output_where_no_folder_can_be_is_refused(drft, short, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    refusal = drft("simulate", short, "-o", tmp_path / "file" / "run.h5").refusal
    assert f"{tmp_path / 'file'} cannot be made a folder" in refusal
    (tmp_path / "taken.h5").mkdir()
    refusal = drft("simulate", short, "-o", tmp_path / "taken.h5").refusal
    assert "cannot be written: it is not an ordinary file" in refusal


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into a read-only folder")
def test_read_only_folder_is_refused(drft, short, tmp_path):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert "permission denied" in drft("simulate", short, "-o", locked / "run.h5").refusal


@pytest.mark.parametrize("option", ["--like", "--from"])
def test_file_that_is_no_run_is_refused(drft, tmp_path, option):
    junk = tmp_path / "junk.h5"
    junk.write_bytes(b"not HDF5 at all")
    assert drft("simulate", option, junk).refusal == f"{junk}: is not an HDF5 file"
    junk.write_bytes(b"")
    assert drft("simulate", option, junk).refusal == f"{junk}: is empty"
    assert "no such file" in drft("simulate", option, tmp_path / "gone.h5").refusal
    assert "is a folder" in drft("simulate", option, tmp_path).refusal


def test_set_up_given_as_like_is_refused_and_as_result_has_no_runs(drft, short):
    assert "is not an HDF5 file" in drft("simulate", "--like", short).refusal
    told = drft("simulate", "--from", short, "--run", "a").refusal
    assert "is one set-up and holds no runs" in told


def test_sand_too_soft_to_carry_the_wheel_is_refused(drft, short, tmp_path):
    soft = tmp_path / "soft.toml"
    soft.write_text(SOFT)
    assert "the sand is too soft for this load" in drft("simulate", soft).refusal
    assert "too soft" in drft("simulate", short, "--zeta", "0.05").refusal


def test_simulation_that_diverges_is_refused_with_its_time(short):
    trial = read_setup(short).trial()
    output = trial.run()
    burst = eqx.tree_at(lambda o: o.z, output, output.z.at[40:].set(jnp.nan))
    with pytest.raises(InputError, match=r"diverges near 0\.4 s; a shorter step may hold it"):
        check_output(burst, trial.simulator)
    check_output(output, trial.simulator)


def test_words_of_a_title_steer_nothing(drft, short):
    title = 'title = "[red]loud[/blue] \\u001b[31m"'
    short.write_text(SHORT.replace('title = "a short run"', title))
    answer = drft("simulate", short)
    assert answer.code == 0
    assert "[red]loud[/blue] \ufffd[31m: 1 s" in answer.out


# Results that are none --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not JSON: it ends at line 1"),
        ("[]", "must hold named entries, holds a list"),
        ("{}", "is not a fit's result; its schema must be 'drft-fit'"),
        ('{"schema": "drft-run", "schema_version": 1}', "is not a fit's result"),
        (
            '{"schema": "drft-fit", "schema_version": 2, "runs": []}',
            "schema_version 2 is not known",
        ),
        ('{"schema": "drft-fit", "schema_version": 1}', "the entry 'runs' is missing"),
        ('{"schema": "drft-fit", "schema_version": 1, "runs": []}', "holds no runs"),
        ('{"schema": "drft-fit", "schema_version": 1, "runs": 3}', "runs: expected a list"),
        (
            '{"schema": "drft-fit", "schema_version": 1, "runs": [{"name": "a", "setup": {}}]}',
            "the entry 'command' is missing in [runs[0].setup]",
        ),
    ],
)
def test_json_that_is_no_result_is_refused(drft, tmp_path, text, said):
    path = tmp_path / "fit.json"
    path.write_text(text)
    assert said in drft("simulate", "--from", path).refusal


def test_hdf5_that_is_no_result_is_refused(drft, tmp_path):
    run = DATA / "runs" / "fast.h5"
    refusal = drft("simulate", "--from", run).refusal
    assert refusal == f"{run}: is a 'drft-run' file, it must be a 'drft-fit' file"
    path = tmp_path / "fit.h5"
    write_result(path, FIT_SCHEMA, {}, {})
    assert drft("simulate", "--from", path).refusal == f"{path} holds no runs"
    write_result(path, FIT_SCHEMA, {}, {"a": {"time": ([0.0, 1.0], "s")}})
    assert "the group a holds no set-up of a fitted run" in drft("simulate", "--from", path).refusal
    write_result(path, FIT_SCHEMA, {}, {"a": {}}, version=2)
    assert "newer than 1" in drft("simulate", "--from", path).refusal
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert str(path) in drft("simulate", "--from", path).refusal
    with h5py.File(path, "w"):
        pass
    assert "is not a 'drft-fit' file: it has no attribute schema" in (
        drft("simulate", "--from", path).refusal
    )


# Thinned commands -------------------------------------------------------------------------------


def test_thinned_command_keeps_its_corners_and_nothing_else():
    time = np.linspace(0, 24, 2401)
    knots = [0, 2, 7, 17, 22, 24]
    omega = np.interp(time, knots, [0, 0, 0.5, 0.5, 0, 0])
    thin = decimate_command(CommandSetUp(time.tolist(), omega.tolist()))
    np.testing.assert_allclose(thin.time, knots, rtol=0, atol=ROUNDING)


def test_thinned_command_is_the_same_function_of_time():
    random = np.random.default_rng(3)
    time = np.cumsum(random.uniform(0.01, 0.1, 200))
    omega = np.where(time < 3, np.sin(time), 0.4)
    vx = np.interp(time, [1, 4], [0, 0.2])
    thin = decimate_command(CommandSetUp(time.tolist(), omega.tolist(), vx.tolist()))
    assert len(thin.time) < len(time)
    np.testing.assert_allclose(np.interp(time, thin.time, thin.omega), omega, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(np.interp(time, thin.time, thin.vx), vx, rtol=0, atol=ROUNDING)


def test_log_of_a_run_says_what_its_wheel_was():
    setup = SetUp(command=CommandSetUp([0, 0.1], [0, 0]))
    setup.wheel = WheelSetUp(grouser_height=0.03, grouser_fraction=1 / 3, plate_size=0.02)
    assert simulated_run(setup).setup.grouser_height == pytest.approx(0.01)


def test_log_of_an_outlined_wheel_is_taken_for_no_other():
    """The format has no place for an outline: a plain rim of its radius sinks otherwise."""
    setup = SetUp(command=CommandSetUp([0, 0.1], [0, 0]))
    corners = 0.15 * np.exp(2j * np.pi * np.arange(7) / 7)
    points = [(float(each.real), float(each.imag)) for each in corners]
    setup.wheel = WheelSetUp(shape="outline", points=points, radius=0.14, plate_size=0.02)
    with pytest.raises(InputError, match="lacks wheel_width, without which it cannot be simulated"):
        setup_from_run(simulated_run(setup))
