"""A run that has everything, and the run logs that others made."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.check import check_files, read_runs_guarded
from drftjax.runlog.hdf5.api import read_result, read_run, write_result, write_run
from drftjax.runlog.record import Events, Measured, RecordedCommand, RecordedSetup, RunLog
from drftjax.runlog.result_file import ResultGroup
from tests.helpers.run_logs import example_run, flattened

SHARED = Path(__file__).resolve().parents[4] / "shared"
EXAMPLES = [
    path
    for folder in ("reference_rigs", "blind/single_practice/set_01", "granular")
    for path in sorted((SHARED / folder).glob("*.h5"))
    # It starts above the sand, which the check tells.
    if path.stem != "drop_20mm"
]


def test_a_run_comes_back_as_it_was_written(tmp_path):
    run = example_run()
    write_run(tmp_path / "run.h5", run)
    assert flattened(read_run(tmp_path / "run.h5")) == flattened(
        dataclasses.replace(run, events=dataclasses.replace(run.events, meanings=MEANINGS))
    )


# CF's flag_meanings are words apart by blanks, so blanks inside one become underscores.
MEANINGS = {1: "tick_late", 2: "fault"}


def test_the_smallest_run_comes_back_as_it_was_written(tmp_path):
    run = RunLog(
        setup=RecordedSetup(),
        command=RecordedCommand([0.0], [0.0]),
        measured=Measured([5.0], z=[-0.01]),
        source="measured",
        title="",
    )
    write_run(tmp_path / "run.h5", run)
    assert flattened(read_run(tmp_path / "run.h5")) == flattened(run)
    assert check_files([tmp_path / "run.h5"]) == [[]]


def test_a_run_of_the_loop_passes_the_check_with_every_channel(tmp_path):
    write_run(tmp_path / "run.h5", example_run())
    assert check_files([tmp_path / "run.h5"]) == [[]]


def test_a_run_of_the_loop_recorded_without_fz_sim_is_read_and_written(tmp_path):
    run = example_run()
    older = dataclasses.replace(run, online=dataclasses.replace(run.online, fz_sim=None))
    write_run(tmp_path / "older.h5", older)
    with h5py.File(tmp_path / "older.h5") as file:
        assert "fz_sim" not in file["online"]
    read = read_run(tmp_path / "older.h5")
    assert read.online.fz_sim is None
    np.testing.assert_array_equal(read.online.tuned, run.online.tuned)
    assert check_files([tmp_path / "older.h5"]) == [[]]


def test_the_guarded_reader_reads_what_the_plain_one_reads(tmp_path):
    write_run(tmp_path / "run.h5", example_run())
    (guarded,) = read_runs_guarded([tmp_path / "run.h5"])
    assert flattened(guarded) == flattened(read_run(tmp_path / "run.h5"))


def test_h5py_reads_a_written_run(tmp_path):
    write_run(tmp_path / "run.h5", example_run())
    with h5py.File(tmp_path / "run.h5") as file:
        z = file["measured/z"]
        assert z.fletcher32
        assert z.chunks is not None
        assert z.attrs["units"] == "m"
        assert z.dims[0][0].name == "/measured/time"
        np.testing.assert_array_equal(z[()], example_run().measured.z)
        assert file.attrs["schema"] == "drft-run"
        assert file.attrs["title"] == example_run().title
        assert list(file["events/code"].attrs["flag_values"]) == [1, 2]


def test_xarray_reads_a_written_run_with_its_time_axis(tmp_path):
    xarray = pytest.importorskip("xarray")
    write_run(tmp_path / "run.h5", example_run())
    with xarray.open_dataset(
        tmp_path / "run.h5", engine="h5netcdf", group="measured", decode_times=False
    ) as data:
        assert data["z"].dims == ("time",)
        np.testing.assert_array_equal(data["z"].values, example_run().measured.z)
        np.testing.assert_array_equal(data["time"].values, example_run().measured.time)


def test_a_run_edited_by_hand_is_still_read(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        file.attrs["title"] = "a better title"
        file.attrs["weather"] = "rain"
    assert read_run(path).title == "a better title"


def test_text_as_bytes_and_numbers_of_other_types_are_read(tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, example_run())
    with h5py.File(path, "r+") as file:
        file.attrs["title"] = np.bytes_("plain")
        file["measured/z"].attrs["units"] = np.bytes_("m")
        file["setup"].attrs["grouser_count"] = np.float32(12)
        file["setup"].attrs["mass_z"] = np.array([18], dtype=np.int16)
        file["setup"].attrs["mass_x"] = np.array(13.5, dtype=">f4")
    run = read_run(path)
    assert run.title == "plain"
    assert (run.setup.grouser_count, run.setup.mass_z, run.setup.mass_x) == (12, 18.0, 13.5)


@pytest.mark.skipif(not EXAMPLES, reason="the shared example run logs are not beside the project")
def test_every_example_is_read_and_passes_the_check():
    for path, violations in zip(EXAMPLES, check_files(EXAMPLES), strict=True):
        assert [str(each) for each in violations] == [], path
    for path, run in zip(EXAMPLES, read_runs_guarded(EXAMPLES), strict=True):
        with h5py.File(path) as file:
            np.testing.assert_array_equal(run.measured.z, file["measured/z"][()])
            np.testing.assert_array_equal(run.command.omega, file["command/omega"][()])
            assert run.setup.mass_z == file["setup"].attrs["mass_z"]


def test_a_result_comes_back_as_it_was_written(tmp_path):
    path = tmp_path / "fit.h5"
    covariance = np.array([[1.0, 0.5], [0.5, np.inf]])
    groups = {
        "estimate": ResultGroup({"covariance": (covariance, "1")}, {"names": ["zeta", "λ"]}),
        "residual": {"z": (np.arange(5), "m"), "used": (np.array([True, False]), "1")},
    }
    write_result(path, "drft-fit", {"title": "Übung", "rounds": 7, "cost": 0.25}, groups)
    result = read_result(path, "drft-fit")
    assert (result.attributes["title"], result.attributes["rounds"]) == ("Übung", 7)
    assert result["estimate"].attributes["names"] == ["zeta", "λ"]
    np.testing.assert_array_equal(result["estimate"]["covariance"], covariance)
    np.testing.assert_array_equal(result["residual"]["z"], np.arange(5))
    assert result["residual"].datasets["z"][1] == "m"


def test_a_result_is_refused_as_another_kind_or_from_a_newer_program(tmp_path):
    path = tmp_path / "fit.h5"
    write_result(path, "drft-fit", {}, {}, version=2)
    with pytest.raises(InputError, match=r"fit\.h5.*'drft-fit'.*must be a 'drft-sweep'"):
        read_result(path, "drft-sweep")
    with pytest.raises(InputError, match=r"fit\.h5.*newer than 1"):
        read_result(path, "drft-fit")
    with pytest.raises(InputError, match=r"must be a 'drft-run'"):
        read_run(path)


@pytest.mark.parametrize(
    ("build", "reason"),
    [
        (lambda: RecordedCommand([0, 1], [0, 1, 2]), "omega has 3 rows but time has 2"),
        (lambda: RecordedCommand([0, 0], [0, 1]), "time must increase"),
        (lambda: RecordedCommand([0, 1], [0, np.nan]), "omega has 1 values that are not finite"),
        (lambda: RecordedCommand([], []), "time has no rows"),
        (lambda: RecordedCommand([[0]], [[1]]), "must be one column"),
        (lambda: RecordedCommand(["0"], [1]), "must hold real numbers"),
        (lambda: Measured([0.0]), "nothing was measured"),
        (lambda: RecordedSetup(wheel_radius=-0.1), "wheel_radius is -0.1, it must be above 0"),
        (lambda: RecordedSetup(grouser_count=1.5), "whole number"),
        (lambda: RecordedSetup(mass_x=np.inf), "finite"),
        (lambda: RecordedSetup().require("mass_z"), "does not give mass_z"),
        (lambda: Events([1, 0], [1, 1], [0, 0]), "event_time must increase"),
        (lambda: dataclasses.replace(example_run(), source="me"), "source is 'me'"),
        (lambda: dataclasses.replace(example_run().online, tick=0.0), "tick is 0.0"),
        (lambda: dataclasses.replace(example_run().online, tuned=[256] * 30), "cannot hold"),
    ],
)
def test_a_record_that_cannot_be_is_refused_when_it_is_built(build, reason):
    with pytest.raises(InputError, match=reason):
        build()


def test_a_record_cannot_be_changed():
    given = np.array([0.0, 1.0])
    command = RecordedCommand(given, given)
    given[0] = 9.0
    assert command.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        command.time[0] = 1.0
