"""Runs in the files of other programs, each read back by another reader; derived channels."""

import dataclasses
import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from drftjax.common.errors import InputError
from drftjax.runlog.export.channels import derived_channels, groups_of, one_table, slope
from drftjax.runlog.export.writers import exported_files
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.importers.guess.proposal import propose_mapping
from drftjax.runlog.importers.mapped_runs import import_table
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

# Text carries twelve digits.
DIGITS = 1e-11
# An integral by quadrature, and sums over a window that cancel.
QUADRATURE, CANCELLED = 1e-9, 1e-9

RUNS = Path(__file__).parents[4] / "data" / "runs"
SETUP = RecordedSetup(wheel_radius=0.1, wheel_width=0.1, mass_z=10.0, gravity=9.81)
KNOTS, OMEGA = np.array([0.0, 1.0, 3.0, 4.0]), np.array([0.0, 2.0, 2.0, 0.0])
TIME = np.linspace(0.0, 4.0, 81)


def rig(**channels) -> RunLog:
    measured = {"x": 0.1 * TIME, "z": -0.02 - 0.001 * TIME} | channels
    return RunLog(
        setup=SETUP,
        command=RecordedCommand(KNOTS, OMEGA),
        measured=Measured(TIME, **measured),
        source="measured",
        title="a run",
    )


def test_derived_channels_follow_from_their_definitions():
    run = rig(fx=5 + TIME, fz=50 + 0 * TIME, torque=3 + 0 * TIME)
    found = {name: each.values for name, each in derived_channels(run).items()}
    speed = np.interp(TIME, KNOTS, OMEGA)
    turned = [quad(lambda t: np.interp(t, KNOTS, OMEGA), 0, t, points=[1, 3])[0] for t in TIME]
    np.testing.assert_allclose(found["wheel_angle"], turned, atol=QUADRATURE)
    np.testing.assert_array_equal(found["sinkage"], -run.measured.z)
    np.testing.assert_allclose(found["speed"], 0.1, rtol=CANCELLED)
    turning = (TIME > 0.05) & (TIME < 3.95)
    slip = 1 - 0.1 / (0.1 * speed[turning])
    np.testing.assert_allclose(found["slip"][turning], slip, rtol=CANCELLED, atol=CANCELLED)
    assert np.isnan(found["slip"][[0, -1]]).all()
    np.testing.assert_allclose(found["drawbar_coefficient"], (5 + TIME) / 50, rtol=DIGITS)
    np.testing.assert_allclose(found["power"], 3 * speed, rtol=DIGITS)
    weighed = derived_channels(rig(fx=5 + TIME))["drawbar_coefficient"].values
    np.testing.assert_allclose(weighed, (5 + TIME) / 98.1, rtol=DIGITS)


def test_a_driven_carriage_has_the_speed_that_it_is_given():
    command = RecordedCommand(KNOTS, OMEGA, np.array([0.0, 0.15, 0.15, 0.0]))
    found = derived_channels(dataclasses.replace(rig(), command=command))
    np.testing.assert_allclose(found["slip"].values[40], 1 - 0.15 / 0.2, rtol=DIGITS)
    assert set(found) == {"wheel_angle", "sinkage", "speed", "slip"}


def test_the_slope_of_a_parabola_at_uneven_times_is_its_derivative():
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 200)) + 1e4
    # Over an even window a parabola's line has the slope of its middle; here it is nearly even.
    found = slope(time, (time - 1e4) ** 2, 0.2)[20:-20]
    np.testing.assert_allclose(found, 2 * (time[20:-20] - 1e4), atol=0.03)
    np.testing.assert_allclose(slope(time, 3 * time, 0.2), 3.0, rtol=1e-6)
    np.testing.assert_allclose(slope(np.array([0.0, 9.0]), np.array([0.0, 18.0]), 0.1), 2.0)


def test_one_table_has_the_commands_at_the_times_of_the_readings():
    late = dataclasses.replace(rig(), command=RecordedCommand(KNOTS + 0.5, OMEGA))
    table = one_table(late)
    assert list(table) == ["time", "omega", "x", "z"]
    assert np.isnan(table["omega"].values[TIME < 0.5]).all()
    expected = np.interp(TIME, KNOTS + 0.5, OMEGA)[TIME >= 0.5]
    np.testing.assert_allclose(table["omega"].values[TIME >= 0.5], expected, rtol=DIGITS)
    assert groups_of(late)["command"]["omega"].values.size == 4


def the_file(run: RunLog, name: str, **options) -> bytes:
    ((path, data),) = exported_files(run, Path(name), **options).items()
    assert path.name == name
    return data


def test_a_csv_is_read_by_numpy_and_by_the_import_again(tmp_path):
    run = read_run(RUNS / "fast.h5")
    (tmp_path / "fast.csv").write_bytes(the_file(run, "fast.csv"))
    rows = np.genfromtxt(tmp_path / "fast.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(rows[:, 2], run.measured.x, rtol=DIGITS)
    (tmp_path / "map.toml").write_text(propose_mapping(tmp_path / "fast.csv").text)
    (again,) = import_table(tmp_path / "fast.csv", tmp_path / "map.toml")
    np.testing.assert_allclose(again.measured.z, run.measured.z, rtol=DIGITS)
    np.testing.assert_allclose(again.measured.time, run.measured.time, rtol=DIGITS)
    tabs = the_file(run, "fast.tsv").decode().splitlines()[0]
    assert tabs == "time [s]\tomega [rad/s]\tx [m]\tz [m]"


def test_groups_are_a_table_each_at_their_own_times():
    files = exported_files(rig(), Path("out/run.csv"), groups=True, derived=True)
    names = ["run_command.csv", "run_measured.csv", "run_derived.csv"]
    assert [path.name for path in files] == names
    assert all(path.parent == Path("out") for path in files)
    assert len(files[Path("out/run_command.csv")].splitlines()) == 5
    assert len(files[Path("out/run_derived.csv")].splitlines()) == 82


def test_a_parquet_file_has_units_and_gaps():
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(BytesIO(the_file(rig(), "run.parquet", derived=True)))
    assert table.schema.field("x").metadata == {b"unit": b"m"}
    np.testing.assert_array_equal(table["x"].to_numpy(), rig().measured.x)
    assert np.isnan(table["slip"].to_numpy()[0])


def test_a_mat_file_is_a_struct_of_groups():
    from scipy.io import loadmat

    found = loadmat(BytesIO(the_file(rig(), "run.mat", derived=True)), simplify_cells=True)["run"]
    np.testing.assert_array_equal(found["command"]["omega"], OMEGA)
    np.testing.assert_array_equal(found["measured"]["z"], rig().measured.z)
    assert found["setup"]["wheel_radius"] == 0.1
    assert found["units"]["derived"]["slip"] == "1"


def test_a_netcdf_file_opens_in_xarray_as_one_data_set(tmp_path):
    import xarray

    run = read_run(RUNS / "slow_a.h5")
    (tmp_path / "run.nc").write_bytes(the_file(run, "run.nc", derived=True))
    with xarray.open_dataset(tmp_path / "run.nc", engine="scipy") as found:
        np.testing.assert_array_equal(found["measured_z"], run.measured.z)
        assert found["measured_z"].dims == ("measured_time",)
        assert found["command_omega"].sel(command_time=7.0) == pytest.approx(np.pi / 6)
        assert found["derived_slip"].attrs["units"] == "1"
        assert found.attrs["wheel_radius"] == 0.15


def test_an_mcap_file_has_a_topic_for_each_group_in_order_of_time():
    from mcap.reader import make_reader

    run = dataclasses.replace(rig(), created="2026-03-01T10:00:00+00:00")
    reader = make_reader(BytesIO(the_file(run, "run.mcap", derived=True)))
    found = [
        (channel.topic, message.log_time, json.loads(message.data))
        for _, channel, message in reader.iter_messages()
    ]
    assert {topic for topic, *_ in found} == {"/command", "/measured", "/derived"}
    start = 1_772_359_200 * 1_000_000_000
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)
    heights = [(time, each["z"]) for topic, time, each in found if topic == "/measured"]
    np.testing.assert_array_equal([each for _, each in heights], run.measured.z)
    assert heights[20][0] == start + 1_000_000_000
    assert "slip" not in next(each for topic, _, each in found if topic == "/derived")


def test_what_cannot_be_exported_is_refused(drft, tmp_path):
    with pytest.raises(InputError, match=r"run\.h5: the name of an exported file must end in one"):
        exported_files(rig(), Path("run.h5"))
    with pytest.raises(InputError, match="leave out --groups"):
        exported_files(rig(), Path("run.mat"), groups=True)
    path, out = tmp_path / "run.h5", tmp_path / "run.csv"
    write_run(path, rig())
    assert drft("log", "export", path, "-o", out, "--derived").out == f"wrote {out}\n"
    assert f"{out} is already there; give --force" in drft("log", "export", path, "-o", out).refusal
    assert drft("log", "export", path, "-o", out, "--force").code == 0
    lost = drft("log", "export", path, "-o", tmp_path / "no" / "run.csv").refusal
    assert "there is no folder" in lost
    assert "no such file" in drft("log", "export", tmp_path / "none.h5", "-o", out).refusal


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"run\.parquet: writing \.parquet needs pyarrow: pip ins"):
        exported_files(rig(), Path("run.parquet"))
