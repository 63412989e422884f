"""`drft diagnose` and `drft evaluate`: from run logs to a verdict, a model file and a report."""

import contextlib
import dataclasses
import io
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from diagnose.blind.answers.answer_file import Answer
from diagnose.commands.diagnose import diagnose
from diagnose.evaluation.model_reader import read_model_file
from diagnose.gap.selected_effects import as_model
from diagnose.rig_runs import gather_runs
from diagnose.settings import DEFAULT_SETTINGS
from drftjax.common.errors import InputError
from drftjax.effects.surface import SurfaceSlope
from drftjax.runlog.hdf5.api import read_run, write_run
from drftjax.runlog.record import RunLog
from drftjax.setups.setup import read_setup
from tests.helpers.synthetic_runs import recorded, setup_of

SLOPE = 0.02
PROFILES = (
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 0.5, 0.5]),
    ([0.0, 0.3, 1.3, 4.0], [0.0, 0.0, 0.9, 0.9]),
)
ZETAS = (0.75, 0.757, 0.745)
# What three short runs with 20 um of noise tell a slope over 0.3 m to, and each run's zeta.
TOLD = 0.005
# The mean of zetas that scatter by half a per cent is not quite a run's own: 0.1 mm of sinkage, and
# as much again where it drives off [m].
MEAN_ZETA = 0.2e-3
# The floor is what two repeats differ by; three runs, with an effect's numbers beside, are a little
# farther off.
CLOSED = 1.2
# Eq. 7's dead band: all that is left where zeta need not move [mm].
DEAD_BAND = 0.1
# Weights that are written with all their digits.
ROUNDING = 1e-12
# What a page must not take for its own words.
HOSTILE = "<script>alert(1)</script> & [bold] $x$"
KEYS = {
    "schema",
    "schema_version",
    "provenance",
    "verdict",
    "weights",
    "groups",
    "gap",
    "steps",
    "budget",
    "gap_one_zeta",
    "bed",
    "where",
    "parameters",
    "drive",
    "correction",
    "next_run",
    "notes",
}


def run(number: int, title: str = "a run") -> RunLog:
    """A run on a slope; its plates are those of a run log's set-up."""
    setup = setup_of(PROFILES[number], ZETAS[number])
    setup.wheel.plate_size = read_setup("data/paper.toml").wheel.plate_size
    setup.effects = [{"name": "surface_slope", "slope": SLOPE}]
    setup.title = title
    return recorded(setup, seed=number, rate=100.0)


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    """Three runs, two of one command, and a text file with a run log's name."""
    folder = tmp_path_factory.mktemp("runs")
    for number in range(3):
        write_run(folder / f"run_{number}.h5", run(number, HOSTILE))
    (folder / "notes.h5").write_text("not a run log")
    return folder


@pytest.fixture(scope="module")
def diagnosed(logs, tmp_path_factory) -> tuple[Path, str]:
    """The folder of a diagnosis, and what was printed."""
    folder = tmp_path_factory.mktemp("diagnosed") / "new" / "folder"
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        diagnose([logs], folder, effects="surface_slope, travel_gain", quiet=False)
    return folder, text.getvalue()


# Bad inputs ---------------------------------------------------------------------------------------


def test_no_runs_is_refused(drft):
    assert drft("diagnose").code == 2


def test_a_folder_without_runs_is_refused(drft, tmp_path):
    assert "holds no run log" in drft("diagnose", tmp_path).refusal


def test_a_folder_of_folders_says_so(drft, tmp_path, logs):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "a.h5").write_bytes((logs / "run_0.h5").read_bytes())
    assert "name one of them" in drft("diagnose", tmp_path).refusal


def test_a_missing_or_text_file_is_named(drft, tmp_path, logs):
    assert "nowhere.h5" in drft("diagnose", tmp_path / "nowhere.h5").refusal
    assert "not an HDF5 file" in drft("diagnose", logs / "notes.h5").refusal


def test_an_unknown_effect_brings_near_names(drft, logs):
    refusal = drft("diagnose", logs, "--effects", "surface_slop,loosening").refusal
    assert "'surface_slop'" in refusal
    assert "surface_slope" in refusal
    assert "names no effect" in drft("diagnose", logs, "--effects", " , ").refusal


def test_an_output_that_cannot_be_a_folder_is_refused_before_the_work(drft, logs, tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("here already")
    assert str(taken) in drft("diagnose", logs, "-o", taken).refusal
    assert taken.read_text() == "here already"


def other_wheel(log: RunLog, radius: float) -> RunLog:
    return dataclasses.replace(log, setup=dataclasses.replace(log.setup, wheel_radius=radius))


def test_runs_of_a_minor_wheel_are_left_out_by_name(logs, tmp_path):
    odd = tmp_path / "odd.h5"
    write_run(odd, other_wheel(read_run(logs / "run_0.h5"), 0.12))
    gathered = gather_runs([logs, odd])
    assert [each.name for each in gathered.runs] == ["run_0", "run_1", "run_2"]
    assert "radius 120 mm" in gathered.skipped["odd"]
    assert "radius 150 mm" in gathered.skipped["odd"]
    assert "not an HDF5 file" in gathered.skipped["notes"]


def test_as_many_runs_of_each_of_two_wheels_are_refused(logs, tmp_path, drft):
    odd = tmp_path / "odd.h5"
    write_run(odd, other_wheel(read_run(logs / "run_0.h5"), 0.12))
    assert "different wheels" in drft("diagnose", logs / "run_0.h5", odd).refusal


def test_a_run_without_sinkage_is_left_out(logs, tmp_path):
    log = read_run(logs / "run_0.h5")
    write_run(
        tmp_path / "flat.h5",
        dataclasses.replace(log, measured=dataclasses.replace(log.measured, z=None)),
    )
    with pytest.raises(InputError, match="/measured/z"):
        gather_runs([tmp_path / "flat.h5"])


def test_a_run_named_twice_counts_once(logs):
    gathered = gather_runs([logs, logs / "run_0.h5"])
    assert [each.name for each in gathered.runs] == ["run_0", "run_1", "run_2"]
    assert gathered.skipped[str(logs / "run_0.h5")].endswith("is given twice; it counts once")


# What comes out -----------------------------------------------------------------------------------


def test_the_verdict_and_what_was_left_out_are_printed(diagnosed):
    _, text = diagnosed
    assert text.startswith("left out: ")
    assert "These runs show surface_slope" in text
    assert "The noise floor is from repeats: run_0 and run_1" in text
    assert "written: " in text


def test_the_json_has_the_documented_layout(diagnosed):
    document = json.loads((diagnosed[0] / "diagnosis.json").read_text())
    assert set(document) == KEYS
    assert (document["schema"], document["schema_version"]) == ("drft-diagnosis", 2)
    answer = msgspec.convert(document, Answer)
    assert answer.verdict == ["surface_slope"]
    # A set counts for each of its names, and a remainder for "unknown".
    assert sum(answer.weights.values()) >= 1 - ROUNDING
    slope = document["parameters"]["surface_slope"]["slope"]
    assert set(slope) == {"value", "error", "unit"}
    assert slope["value"] == pytest.approx(SLOPE, rel=TOLD)
    for share in document["where"]:
        assert set(share) == {"axis", "label", "share", "interval"}
        assert share["interval"][0] <= share["share"] <= share["interval"][1]
    assert document["correction"] is None
    assert document["provenance"]["command"][0] == "diagnose"
    assert document["provenance"]["seed"] == DEFAULT_SETTINGS.localization.seed
    assert any("notes.h5" in note for note in document["notes"])


def test_the_page_refers_to_nothing_outside_and_escapes_titles(diagnosed):
    text = (diagnosed[0] / "report.html").read_text()
    assert HOSTILE not in text
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; [bold]" in text
    assert "<link" not in text
    assert "default-src 'none'" in text
    # The library's own comment names its home; tests in a browser see that nothing is loaded.
    assert re.findall(r"https?:[^ ]*", text) == ["https://github.com/leeoniya/uPlot"]
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert sources
    assert all(each.startswith("data:image/svg+xml;base64,") for each in sources)
    for figure in ("Gap before and after", "Weights", "Simulated less recorded over time"):
        assert figure in text


def test_the_model_file_simulates(diagnosed, drft, tmp_path):
    model = diagnosed[0] / "model.toml"
    setup = read_setup(model)
    assert np.mean(ZETAS) == pytest.approx(setup.terrain.zeta, rel=TOLD)
    assert "± " in model.read_text()
    assert drft("simulate", model, "-o", tmp_path / "again.h5").code == 0
    again, first = read_run(tmp_path / "again.h5"), run(0)
    assert again.measured.z is not None
    assert first.measured.z is not None
    then = np.interp(first.measured.time, again.measured.time, again.measured.z)
    assert np.abs(then - first.measured.z).max() < MEAN_ZETA


def test_the_model_file_closes_the_gap_of_other_runs(diagnosed, logs, drft, tmp_path):
    found = tmp_path / "new" / "evaluation.json"
    model = diagnosed[0] / "model.toml"
    answer = drft("evaluate", logs, "--model", model, "--tuner", "--json", found)
    assert answer.code == 0
    assert "online tuner" in answer.out
    assert "with surface_slope" in answer.out
    document = json.loads(found.read_text())
    assert (document["schema"], document["schema_version"]) == ("drft-evaluation", 1)
    assert str(model) in [each["name"] for each in document["provenance"]["inputs"]]
    z = document["gap"]["z"]
    assert z["unit"] == "mm"
    assert z["before"] > 3 * z["floor"]
    assert z["after"] < CLOSED * z["floor"]
    assert [each["name"] for each in document["runs"]] == ["run_0", "run_1", "run_2"]
    moved = [[each[w]["moved"] for w in ("before", "after")] for each in document["tuner"]["runs"]]
    assert all(after < before for before, after in moved)
    assert all(each["after"]["sinkage_mm"] < DEAD_BAND for each in document["tuner"]["runs"])


def test_a_model_without_effects_is_the_reference_model(logs, drft):
    answer = drft("evaluate", logs / "run_0.h5", "--model", "data/paper.toml")
    assert answer.code == 0
    assert "it is the reference model" in answer.out


def test_evaluate_says_of_which_wheel_the_model_was_and_that_repeats_disagree(
    diagnosed, logs, drft, tmp_path
):
    model = tmp_path / "model.toml"
    text = (diagnosed[0] / "model.toml").read_text()
    model.write_text(text.replace("radius = 0.15", "radius = 0.12"))
    for number in (0, 1):
        # Of one command and load: the second sinks by millimetres from its middle on.
        first = read_run(logs / "run_0.h5")
        z = first.measured.z - number * 4e-3 * (first.measured.time > 2)
        measured = dataclasses.replace(first.measured, z=z)
        write_run(tmp_path / f"like_{number}.h5", dataclasses.replace(first, measured=measured))
    answer = drft("evaluate", tmp_path, "--model", model)
    assert answer.code == 0
    assert "radius 120 mm" in answer.out
    assert "these runs are of a wheel of radius 150 mm" in answer.out
    assert "like_0 and like_1 repeat each other and differ by" in answer.out


def test_evaluate_refuses_what_is_no_model(logs, drft, tmp_path):
    bad = tmp_path / "bad.toml"
    bad.write_text('[command]\ntime = [0, 1]\nomega = [0, 1]\n[[effect]]\nname = "slopes"\n')
    assert "there is no effect 'slopes'" in drft("evaluate", logs, "--model", bad).refusal
    assert "no such file" in drft("evaluate", logs, "--model", tmp_path / "none.toml").refusal
    (tmp_path / "diagnosis.json").write_text('{"schema": "drft-diagnosis"}')
    diagnosis = drft("evaluate", logs, "--model", tmp_path / "diagnosis.json").refusal
    assert diagnosis.endswith("diagnosis.json: is a diagnosis; give its model.toml")
    idle = drft("evaluate", logs, "--model", "data/paper.toml", "--tick", "0.5", "--tolerance", "0")
    assert idle.refusal == "--tick, --tolerance would be ignored: give --tuner too"
    wrong = drft("evaluate", logs, "--model", "data/paper.toml", "--json", tmp_path / "a.txt")
    assert "must end in .json" in wrong.refusal


def test_effects_of_a_file_keep_their_numbers(diagnosed):
    effects = read_model_file(diagnosed[0] / "model.toml").effects
    model, coordinates = as_model(effects)
    (again,) = model.build(coordinates)
    assert isinstance(again, SurfaceSlope)
    assert float(again.slope) == pytest.approx(float(effects[0].slope), rel=ROUNDING)


def test_one_run_is_described_and_proves_nothing(logs, drft, tmp_path):
    picture = tmp_path / "gap.png"
    options = ("--effects", "surface_slope", "-o", tmp_path, "--plot", picture)
    answer = drft("diagnose", logs / "run_0.h5", *options)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert answer.code == 0
    assert "One run only" in answer.out
    assert "one run alone describes and does not prove" in answer.out
    assert "No run was repeated" in answer.out
    assert "on the same runs" in answer.out
