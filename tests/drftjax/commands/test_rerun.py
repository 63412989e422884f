"""`drft rerun`: the origin of a result, the same result again, and what stands in its way."""

import hashlib
import json
import re
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

import drftjax
from drftjax.commands import rerun as module
from drftjax.results.differences import DIFFERENCE_SETTINGS
from drftjax.runlog.hdf5.api import write_run
from drftjax.setups.fitted_model import read_model
from tests.helpers.drft_command import Drft
from tests.helpers.synthetic_runs import SLOW, recorded, setup_of

# A difference in errors is told by two digits.
TOLD = 0.06


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """A run log, and below another folder its fit, made from there."""
    folder = tmp_path_factory.mktemp("bench")
    write_run(folder / "run.h5", recorded(setup_of(SLOW, 0.74), 1))
    return folder


@pytest.fixture
def fitted(bench, drft: Drft, monkeypatch) -> Path:
    """The fit's JSON file."""
    path = bench / "out" / "fit.json"
    if not path.exists():
        monkeypatch.chdir(bench)
        options = ["--own", "zeta", "--bootstrap", "20", "--compare", "z"]
        answer = drft("fit", "run.h5", *options, "-o", "out/fit")
        assert answer.code == 0, answer
    return path


def changed(path: Path, place: Path, **provenance: object) -> Path:
    """Copy of a result with other entries in its provenance."""
    document = json.loads(path.read_text())
    document["provenance"] |= provenance
    place.write_text(json.dumps(document))
    return place


def test_a_result_names_its_origin(fitted, bench):
    origin = json.loads(fitted.read_text())["provenance"]
    digest = hashlib.sha256((bench / "run.h5").read_bytes()).hexdigest()
    assert origin["inputs"] == [{"name": "run.h5", "sha256": digest}]
    assert origin["command"][:2] == ["fit", "run.h5"]
    assert origin["command"][-2:] == ["-o", "out/fit"]
    assert origin["versions"]["jax"] == version("jax")
    assert origin["versions"]["drftjax"] == drftjax.__version__
    assert origin["machine"]["precision"] == "float64"
    assert origin["seed"] == 0  # of the bootstrap
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", origin["date"])


def test_a_call_from_python_names_its_files(bench):
    origin = drftjax.fit(bench / "run.h5", parameters="zeta", compare="z").document()["provenance"]
    assert [each["name"] for each in origin["inputs"]] == [str(bench / "run.h5")]
    assert origin["command"] is None
    assert origin["seed"] is None


def test_readers_need_no_provenance(fitted, tmp_path):
    document = json.loads(fitted.read_text())
    del document["provenance"]
    old = tmp_path / "old.json"
    old.write_text(json.dumps(document))
    assert read_model(old) == read_model(fitted)


def test_a_fit_made_again_elsewhere_is_the_same(fitted, drft, tmp_path, monkeypatch):
    original = fitted.read_bytes()
    monkeypatch.chdir(tmp_path)  # the run log lies above the result
    answer = drft("rerun", fitted)
    assert answer.code == 0, answer
    assert "nothing differs" in answer.out
    assert "entries differ" not in answer.out
    assert fitted.read_bytes() == original
    again = json.loads((fitted.parent / "fit_rerun.json").read_text())
    before = json.loads(original)
    assert again["provenance"]["inputs"] == before["provenance"]["inputs"]
    first, second = (each["runs"][0]["values"]["terrain.zeta"] for each in (before, again))
    for entry in ("value", "error"):
        assert second[entry] == pytest.approx(first[entry], rel=DIFFERENCE_SETTINGS.relative)


def test_a_changed_input_is_told_first_and_moves_numbers(fitted, bench, drft, tmp_path):
    folder = tmp_path / "other"
    (folder / "out").mkdir(parents=True)
    write_run(folder / "run.h5", recorded(setup_of(SLOW, 0.78), 2))
    copied = folder / "out" / "fit.json"
    copied.write_bytes(fitted.read_bytes())
    refusal = drft("rerun", copied).refusal
    digests = [hashlib.sha256((at / "run.h5").read_bytes()).hexdigest() for at in (bench, folder)]
    assert f"was {digests[0][:12]}..., is {digests[1][:12]}..." in refusal
    assert "give --changed-inputs" in refusal
    assert [each.name for each in (folder / "out").iterdir()] == ["fit.json"]

    answer = drft("rerun", copied, "--changed-inputs", "-o", folder / "new")
    assert answer.code == 1, answer
    assert "run.h5 has changed" in answer.out
    first, second = (
        json.loads(path.read_text())["runs"][0]["values"]["terrain.zeta"]
        for path in (copied, folder / "new.json")
    )
    row = next(line for line in answer.out.splitlines() if "terrain.zeta.value" in line)
    _, _, before, after, apart, _ = (cell.strip() for cell in re.split("[│┃]", row))
    assert float(before) == pytest.approx(first["value"])
    assert float(after) == pytest.approx(second["value"])
    errors = abs(first["value"] - second["value"]) / first["error"]
    assert float(apart.removesuffix(" errors")) == pytest.approx(errors, rel=TOLD)


def test_a_missing_input_is_named(fitted, drft, tmp_path):
    moved = tmp_path / "fit.json"
    moved.write_bytes(fitted.read_bytes())
    assert "run.h5 is missing; it must lie where the paths lead" in drft("rerun", moved).refusal


def test_a_run_that_was_put_into_the_folder_is_told(fitted, bench, drft, tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("run.h5", "more.h5"):
        (logs / name).write_bytes((bench / "run.h5").read_bytes())
    (inputs,) = json.loads(fitted.read_text())["provenance"]["inputs"]
    listed = changed(
        fitted,
        tmp_path / "fit.json",
        command=["fit", "logs"],
        inputs=[{**inputs, "name": "logs/run.h5"}],
    )
    assert "logs/more.h5 is new" in drft("rerun", listed).refusal


# Commands of strangers ----------------------------------------------------------------------------


class Started:
    """Stand-in for `subprocess.run` that notes the arguments and refuses like `drft`."""

    def __init__(self) -> None:
        self.commands: list[list[str]] = []
        self.folder: Path | None = None

    def __call__(self, command: list[str], *, cwd: Path, **_: object):
        self.commands.append(command[4:])
        self.folder = cwd
        return subprocess.CompletedProcess(command, 2, None, "Traceback\ndrft: no such sand\n")


@pytest.fixture
def started(monkeypatch) -> Started:
    """Note of the child processes that would have been started."""
    note = Started()
    monkeypatch.setattr(module.subprocess, "run", note)
    return note


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["fit", "--output", "/etc/x"], "missing argument 'runs'"),
        (["fit", "run.h5", "--nope"], "no such option: --nope"),
        (["fit", "run.h5", "--starts", "many"], "invalid value for '--starts'"),
        (["fit", "run.h5", "--help"], "is none that makes a result: drft fit 'run.h5' '--help'"),
        (["fit", "run\0.h5"], "is none that makes a result: drft fit 'run\\x00.h5'"),
        (["fit", "run\ud800.h5"], "is none that makes a result: drft fit 'run\\ud800.h5'"),
        (["fit", "run.h5", "; touch hacked"], "; touch hacked is missing"),
        (["fit", "run.h5", "$(touch hacked)"], "$(touch hacked) is missing"),
        (["fit", "/dev/zero"], "/dev/zero"),
        (["fit", "run.h5", "--cluster", "tcp://10.0.0.1:8786"], "connects to tcp://10.0.0.1:8786"),
        (["diagnose", "run.h5"], "is drft diagnose, which makes no drft-fit"),
        (["hils", "run"], "must be one of fit, crosscheck, design, diagnose, evaluate"),
        (["rm", "-rf", "/"], "the recorded command is drft rm '-rf' '/', must be one of"),
        ([], "must be one of"),
        (None, "was made from Python and names no command"),
        ("fit run.h5", "provenance.command: expected a list or nothing, got text"),
    ],
)
def test_no_other_command_is_run(fitted, bench, drft, started, command, said):
    hostile = changed(fitted, bench / "hostile.json", command=command)
    refusal = drft("rerun", hostile).refusal
    assert str(hostile) in refusal
    assert said in refusal
    assert not started.commands
    hostile.unlink()


def test_recorded_outputs_are_replaced_and_no_shell_reads_arguments(fitted, bench, drft, started):
    given = ["fit", "-o/etc/x", "--own", "zeta; touch hacked", "run.h5", "--autoregressive"]
    given += ["--plot", "/etc/y.png"]
    hostile = changed(fitted, bench / "hostile.json", command=given)
    refusal = drft("rerun", hostile, "-o", bench / "new" / "again").refusal
    assert refusal == f"{hostile} cannot be made again: no such sand"
    (command,) = started.commands
    options = ["--own=zeta; touch hacked", "--autoregressive"]
    assert sorted(command[1:-3]) == sorted(options)
    assert command[0] == "fit"
    assert command[-3:] == ["--output=new/again.json", "--", "run.h5"]
    assert started.folder == bench
    assert not (bench / "new").exists()
    hostile.unlink()


def test_new_names_are_free_ones(fitted, drft, started, bench):
    taken = changed(fitted, bench / "kept.json")
    (bench / "kept_rerun.json").write_text("{}")
    drft("rerun", taken)
    assert "--output=kept_rerun_2.json" in started.commands[0]
    taken.unlink()


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("fit.json", '{"schema": "drft-fit", "schema_version": 1}', "holds no provenance, as"),
        ("fit.json", '{"schema": "drft-fit", "provenance": 3}', "provenance: expected"),
        ("fit.json", "{]", "is not JSON"),
        ("fit.json", '{"a": 1}', "names no schema"),
        ("fit.h5", "", "must end in .json"),
        ("none.json", None, "there is no such file"),
    ],
)
def test_what_is_no_result_is_refused(drft, tmp_path, name, text, said):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    refusal = drft("rerun", path).refusal
    assert str(path) in refusal
    assert said in refusal


def test_a_file_that_was_there_before_is_no_new_result(fitted, drft, monkeypatch):
    ended = subprocess.CompletedProcess([], 0, None, "")
    monkeypatch.setattr(module.subprocess, "run", lambda *_, **__: ended)
    refusal = drft("rerun", fitted, "-o", fitted).refusal
    assert refusal == f"{fitted} cannot be made again: drft fit finds no result to write"


def test_versions_that_changed_are_told(fitted, bench, drft, started):
    versions = json.loads(fitted.read_text())["provenance"]["versions"]
    versions["jax"] = "0.0.1"
    older = changed(fitted, bench / "older.json", versions=versions)
    out = drft("rerun", older)
    assert f"jax was 0.0.1, is {version('jax')}" in out.out
    older.unlink()
