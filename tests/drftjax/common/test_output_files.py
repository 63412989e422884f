"""Where results go: never over a recorded run, and refused before the work that leads to them."""

import dataclasses
import shutil
from pathlib import Path

import h5py
import pytest

from diagnose.report.model_writer import MODEL_FILE_MARK
from drftjax.common.errors import InputError
from drftjax.common.output_files import require_places
from drftjax.runlog.check import require_no_recording
from drftjax.runlog.hdf5.api import read_run, write_result, write_run
from drftjax.setups.fitted_model import FIT_SCHEMA
from drftjax.setups.generated_files import replace_own_setup
from identify.design.report import DESIGNED

DATA = Path(__file__).parents[3] / "data"
PAPER, RUN = DATA / "paper.toml", DATA / "runs" / "fast.h5"


@pytest.fixture
def recording(tmp_path) -> Path:
    path = tmp_path / "mine.h5"
    write_run(path, dataclasses.replace(read_run(RUN), source="measured"))
    return path


def test_a_simulation_never_replaces_a_recorded_run(drft, recording):
    before = recording.read_bytes()
    said = drft("simulate", PAPER, "-o", recording).refusal
    assert said.startswith(f"{recording} holds a run of source 'measured'")
    again = drft("simulate", "--like", recording, "-o", recording).refusal
    assert again == f"{recording} is read here and would be replaced; give another name"
    link = recording.with_name("link.h5")
    link.symlink_to(recording)
    assert "is read here" in drft("simulate", "--like", recording, "-o", link).refusal
    assert recording.read_bytes() == before


@pytest.mark.parametrize("attributes", [{}, {"schema": "logger", "source": "simulated"}])
def test_a_file_of_another_program_is_never_replaced(drft, tmp_path, attributes):
    path = tmp_path / "logger.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
        file["t"] = file["force"] = [0.0, 1.0]
    before = path.read_bytes()
    said = f"{path} is an HDF5 file that holds no simulation or fit"
    assert drft("simulate", PAPER, "-o", path).refusal.startswith(said)
    assert drft("fit", RUN, "-o", path.with_suffix("")).refusal.startswith(said)
    assert path.read_bytes() == before


def test_what_cannot_be_opened_may_be_a_recording(drft, tmp_path):
    path = tmp_path / "torn.h5"
    path.write_bytes(RUN.read_bytes()[:5000])
    assert "move it away" in drft("simulate", PAPER, "-o", path).refusal
    assert path.stat().st_size == 5000


def test_an_earlier_simulation_is_replaced(drft, tmp_path):
    short = tmp_path / "short.toml"
    short.write_text("[wheel]\nshape = 'plain'\n[command]\ntime = [0, 0.2]\nomega = [0, 0.1]\n")
    log = tmp_path / "log.h5"
    assert drft("simulate", short, "-o", log).code == 0
    assert drft("simulate", short, "-o", log).code == 0


def test_an_earlier_fit_is_replaced(tmp_path):
    path = tmp_path / "fit.h5"
    write_result(path, FIT_SCHEMA, {"status": "converged"}, {})
    require_no_recording(path)
    with pytest.raises(InputError, match="source 'virtual rig'"):
        require_no_recording(RUN)


def test_a_fit_never_replaces_a_run(drft, recording):
    before = recording.read_bytes()
    assert "is read here" in drft("fit", recording, "-o", recording).refusal
    assert "source 'measured'" in drft("fit", RUN, "-o", recording.with_suffix("")).refusal
    assert recording.read_bytes() == before


def test_an_earlier_fit_in_the_folder_of_runs_is_replaced(tmp_path):
    """It is no run, so that `drft fit runs -o runs/fit` may be called again."""
    write_result(tmp_path / "fit.h5", FIT_SCHEMA, {"status": "converged"}, {})
    require_places([tmp_path / "fit.h5"], [tmp_path])
    with pytest.raises(InputError, match="is read here"):
        require_places([tmp_path / "fit.h5"], [tmp_path / "fit.h5"])


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("rig.toml", ("design", PAPER, "-o", "rig")),
        ("model.toml", ("diagnose", RUN, "--effects", "drawbar", "-o", ".")),
    ],
)
def test_a_set_up_that_somebody_wrote_is_never_replaced(drft, tmp_path, monkeypatch, name, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("# mine\n")
    assert f"{name} is there and is no earlier result" in drft(*command).refusal
    assert (tmp_path / name).read_text() == "# mine\n"


@pytest.mark.parametrize("mark", [DESIGNED, MODEL_FILE_MARK])
def test_an_earlier_design_or_diagnosis_is_replaced_until_it_is_edited(tmp_path, mark):
    path = tmp_path / "earlier.toml"
    replace_own_setup(path, f"# {mark} something\nzeta = 1\n", mark)
    replace_own_setup(path, f"# {mark} something\nzeta = 2\n", mark)
    edited = path.read_text().replace("zeta = 2", "zeta = 3")
    path.write_text(edited)
    with pytest.raises(InputError, match=r"earlier\.toml is there and has been edited since"):
        replace_own_setup(path, f"# {mark} something\nzeta = 4\n", mark)
    assert path.read_text() == edited


def test_a_design_is_no_earlier_diagnosis(tmp_path):
    path = tmp_path / "model.toml"
    replace_own_setup(path, f"# {DESIGNED} something\n", DESIGNED)
    with pytest.raises(InputError, match="no earlier result of this command"):
        replace_own_setup(path, f"# {MODEL_FILE_MARK} something\n", MODEL_FILE_MARK)


def test_a_design_never_replaces_its_set_up(drft, tmp_path):
    setup = tmp_path / "paper.toml"
    shutil.copy(PAPER, setup)
    assert "is read here" in drft("design", setup, "-o", tmp_path / "paper").refusal


@pytest.mark.parametrize(
    "command",
    [
        ("fit", RUN, "-o"),
        ("fit", RUN, "--cluster", "local:1", "-o"),
        ("crosscheck", RUN, "-o"),
        ("simulate", PAPER, "--plot"),
        ("design", PAPER, "-o"),
        ("evaluate", RUN, "--model", PAPER, "--json"),
        ("diagnose", RUN, "-o"),
        ("blind", "answer", DATA / "blind", "-o"),
    ],
    ids=lambda command: f"{command[0]} {command[-1]}",
)
def test_a_place_that_cannot_be_written_is_refused_at_once(drft, tmp_path, command):
    (tmp_path / "file").write_text("")
    ending = {"--plot": ".png", "--json": ".json"}.get(command[-1], "")
    ending = ".json" if command[0] == "blind" else ending
    answer = drft(*command, tmp_path / "file" / f"x{ending}")
    assert f"{tmp_path / 'file'}" in answer.refusal
    assert "cannot be made a folder" in answer.refusal
    assert answer.out == ""


@pytest.mark.parametrize(
    "command",
    [
        ("fit", "README.md", "-o"),
        ("fit", RUN, "--step", "0", "-o"),
        ("simulate", "README.md", "--plot"),
        ("design", PAPER, "--noise-x", "0", "-o"),
        ("evaluate", "README.md", "--model", PAPER, "--json"),
        ("diagnose", "README.md", "-o"),
    ],
    ids=lambda command: f"{command[0]} {command[-1]}",
)
def test_a_refused_command_leaves_no_folder_that_it_made(drft, tmp_path, command):
    ending = {"--plot": ".png", "--json": ".json"}.get(command[-1], "")
    for folder in (tmp_path / "new" / "deep", tmp_path / "there"):
        (tmp_path / "there").mkdir(exist_ok=True)
        assert drft(*command, folder / f"x{ending}").refusal
    assert [each.name for each in tmp_path.iterdir()] == ["there"]
    assert not list((tmp_path / "there").iterdir())


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no /proc to write to")
def test_a_folder_that_takes_no_file_is_refused_at_once(drft):
    answer = drft("fit", RUN, "-o", "/proc/x")
    assert answer.refusal.startswith("/proc: nothing can be written there")


def test_a_folder_in_the_results_place_is_refused_at_once(drft, tmp_path):
    (tmp_path / "x.json").mkdir()
    answer = drft("crosscheck", RUN, "-o", tmp_path / "x")
    assert answer.refusal == f"{tmp_path / 'x.json'} cannot be written: it is not an ordinary file"
