"""Words for a file or folder that is not there, or is the other of the two."""

import os
from pathlib import Path

import pytest

from drftjax.common.errors import InputError, missing_path, read_failure, require_input_folder
from drftjax.common.output_files import make_folder


@pytest.fixture
def folder(tmp_path):
    for name in ("paper.toml", "run_a.h5", "run_b.h5"):
        (tmp_path / name).touch()
    (tmp_path / "fresh").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("papre.toml", "there is no such file; did you mean 'paper.toml'?"),
        ("run_a.hdf5", "there is no such file; did you mean 'run_a.h5'?"),
        ("xyzzy.csv", "there is no such file"),
        ("frehs", "there is no such file or folder; did you mean 'fresh'?"),
        ("fersh/run_a.h5", "there is no folder {}/fersh; did you mean 'fresh'?"),
        # A file is no folder that was meant.
        ("run/a.h5", "there is no folder {}/run"),
        ("paper.toml/a.h5", "there is no such path: {}/paper.toml is a file, must be a folder"),
    ],
)
def test_a_missing_path_names_the_nearest_one_of_its_folder(folder, given, said):
    assert missing_path(folder / given) == said.format(folder)


def test_a_link_that_leads_nowhere_is_not_its_own_nearest_name(folder):
    (folder / "latest.h5").symlink_to("gone.h5")
    assert missing_path(folder / "latest.h5") == "is a link to gone.h5, which is not there"


def test_names_relative_to_the_current_folder_are_searched(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert missing_path(Path("run_c.h5")).startswith("there is no such file; did you mean 'run_")
    assert missing_path(Path("freshh/a.h5")) == "there is no folder freshh; did you mean 'fresh'?"


def test_reasons_of_the_system_are_words(folder):
    for given, said in (
        ("fresh", "is a folder, must be a file"),
        ("none.h5", "there is no such file"),
        ("a" * 300, "cannot be read: file name too long"),
    ):
        with pytest.raises(OSError) as caught:
            os.open(folder / given, os.O_RDWR)
        assert read_failure(folder / given, caught.value).startswith(said)


def test_a_file_in_the_place_of_a_folder_is_named(folder):
    with pytest.raises(InputError, match=r"run_a\.h5: is a file, must be a folder of runs"):
        require_input_folder(folder / "run_a.h5", "runs")
    with pytest.raises(InputError, match="no such folder; did you mean 'fresh'"):
        require_input_folder(folder / "freshe", "runs")
    taken = folder / "run_a.h5"
    with pytest.raises(InputError, match=f"deeper cannot be made a folder: {taken} is a file"):
        make_folder(taken / "deeper")


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "{}/papre.toml"),
        ("simulate", "--like", "{}/papre.h5"),
        ("simulate", "--from", "{}/papre.json"),
        ("log", "plot", "{}/papre.h5", "-o", "{}/x.png"),
        ("log", "import", "{}/papre.csv", "-o", "{}/x"),
        ("log", "import", "{}/papre.csv", "--guess"),
        ("log", "import", "{}/paper.csv", "--mapping", "{}/papre.toml", "-o", "{}/x"),
        ("log", "repair", "{}/papre.h5.part"),
        ("compare", "{}/papre.json", "{}/paper.json"),
        ("rerun", "{}/papre.json"),
        ("fit", "{}/paper.h5", "--parameters", "{}/papre.toml"),
        ("fit", "{}/papre.h5"),
        ("diagnose", "{}/papre.h5"),
        ("evaluate", "{}/paper.h5", "--model", "{}/papre.toml"),
        ("design", "{}/papre.toml"),
        ("crosscheck", "{}/papre.h5"),
        ("protocol", "{}/papre.toml", "-o", "{}/x"),
        ("bench", "--cpp", "{}/papre.cpp"),
        ("blind", "answer", "{}/papre", "-o", "{}/x.json"),
        ("blind", "score", "{}", "--answers", "{}/papre.json"),
        ("hils", "replay", "{}/papre.h5"),
        ("hils", "rig", "--faults", "{}/papre.toml"),
    ],
    ids=lambda words: "-".join(each for each in words if "{}" not in each),
)
def test_every_command_names_the_file_that_may_be_meant(drft, tmp_path, arguments):
    given = next(each for each in arguments if "papre" in each).format(tmp_path)
    meant = Path(given.replace("papre", "paper"))
    for name in {meant.name, "paper.h5", "paper.csv", "paper.json"}:
        (tmp_path / name).touch()
    refusal = drft(*(each.format(tmp_path) for each in arguments)).refusal
    assert refusal.startswith(f"{given}: there is no such f"), refusal
    assert refusal.endswith(f"did you mean '{meant.name}'?"), refusal
