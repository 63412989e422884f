"""Run logs named on a command line: files and folders of them, each recording once."""

import dataclasses
import shutil
from pathlib import Path

import pytest

from drftjax.recorded.gather import gather
from drftjax.runlog.files import drop_repeated_files, run_files
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.plausibility import plausibility_warnings
from drftjax.runlog.record import RecordedCommand
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

RUNS = Path(__file__).parents[3] / "data" / "runs"


@pytest.fixture
def folder(tmp_path) -> Path:
    shutil.copy(RUNS / "slow_a.h5", tmp_path / "a.h5")
    shutil.copy(RUNS / "slow_a.h5", tmp_path / "copy.h5")
    (tmp_path / "notes.txt").write_text("not looked at")
    return tmp_path


def test_a_copy_or_a_file_given_twice_counts_once(folder):
    first, copy, other = folder / "a.h5", folder / "copy.h5", RUNS / "slow_b.h5"
    kept, left_out = drop_repeated_files(
        [first, first, copy, other, folder / "gone.h5", folder / "gone.h5"]
    )
    assert kept == [first, other, folder / "gone.h5", folder / "gone.h5"]
    assert left_out == {
        str(first): f"{first}: is given twice; it counts once",
        str(copy): f"{copy}: is the same as {first}; it counts once",
    }


def test_a_recording_is_no_repeat_of_itself(folder):
    told: list[str] = []
    gathered = gather([folder], tell=told.append)
    assert [each.name for each in gathered.runs] == ["a"]
    (sentence,) = told
    assert sentence.startswith(f"left out: {folder / 'copy.h5'}: is the same as")


def test_files_with_names_alike_keep_their_names(folder):
    shutil.copy(RUNS / "slow_b.h5", folder / "b.h5")
    gathered = gather([folder / "a.h5", folder / "b.h5", folder / "a.h5"])
    assert [each.name for each in gathered.runs] == ["a", "b"]


def test_folders_are_taken_wherever_runs_are_looked_at(drft, folder):
    assert run_files([folder]) == [folder / "a.h5", folder / "copy.h5"]
    answer = drft("log", "check", folder)
    assert answer.out.splitlines() == [f"{folder / name}: ok" for name in ("a.h5", "copy.h5")]
    assert drft("log", "show", folder).out.count("set-up:") == 2


@pytest.mark.parametrize("command", [("log", "check"), ("fit",), ("crosscheck",), ("diagnose",)])
def test_a_folder_without_runs_is_refused(drft, tmp_path, command):
    assert "the folder holds no run log" in drft(*command, tmp_path).refusal


@pytest.mark.parametrize("command", ["fit", "crosscheck", "diagnose"])
def test_a_lone_file_that_cannot_be_used_is_one_sentence(drft, tmp_path, command):
    path = tmp_path / "text.h5"
    path.write_text("no run log")
    answer = drft(command, path)
    assert answer.refusal == f"{path}: is not an HDF5 file"
    assert "left out" not in answer.out


def test_likely_slips_of_unit_are_told(tmp_path):
    run = recorded(setup_of(SLOW, 0.75), 1)
    command = RecordedCommand(time=run.command.time, omega=60 * run.command.omega)
    path = tmp_path / "turning.h5"
    write_run(path, dataclasses.replace(run, command=command))
    told: list[str] = []
    gather([path], tell=told.append)
    assert told == [f"note: {path}: {doubt}" for doubt in plausibility_warnings(read_run(path))]
    assert "rad/s" in told[0]
