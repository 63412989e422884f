"""Blind sets: seals, scores worked out by hand, and answers that never see a label."""

import json
import math
import os
import subprocess
import sys
import time
import types
from pathlib import Path

import msgspec
import numpy as np
import pytest

from diagnose.blind.answers.answer import answer_sets, runs_of
from diagnose.blind.answers.answer_file import (
    SCHEMA,
    Answer,
    FreshAnswer,
    GapAnswer,
    read_answers,
    write_answers,
)
from diagnose.blind.generation.sealed_labels import HASH_FILE, SEALED_FILE, open_labels, seal
from diagnose.blind.scoring.proportion import Proportion
from diagnose.blind.scoring.score import ScoreSettings, score_answers
from diagnose.commands.blind import app
from drftjax.common.errors import InputError
from drftjax.common.structured_files import as_json
from tests.helpers.drft_command import Drft


def label(effects, floors=None):
    return {"effects": effects} | ({} if floors is None else {"floors": floors})


LABELS = {
    "set_1": label(["drawbar"], 10.0),
    "set_2": label(["loosening"], 2.0),
    "set_3": label([]),
    "set_4": label(["unknown"], 5.0),
    "set_5": label(["speed_lag", "cohesion"], 5.0),
    "set_6": label(["eccentricity"], 3.0),
    "set_7": label(["drawbar", "backlash"], 9.0)
    | {"mechanisms": [{"floors": 8.0}, {"floors": 1.0}]},
}
ANSWERS = {
    "set_1": Answer(
        ["drawbar"],
        {"drawbar": 0.95, "cable_spring": 0.05},
        [["drawbar", "cable_spring"]],
        {"x": GapAnswer(1.0, 0.1, 0.08, 0.85, (0.8, 0.9))},
        {"x": FreshAnswer(1.0, 0.2)},
    ),
    "set_2": Answer(
        ["excavation"],
        {"excavation": 0.85, "loosening": 0.15},
        [["excavation", "loosening", "slip_softening"]],
        {"x": GapAnswer(1.0, 0.1, 0.08, 0.9, (0.85, 0.95))},
        {"x": FreshAnswer(2.0, 1.0)},
    ),
    "set_3": Answer(["drawbar"], {"drawbar": 0.6, "none": 0.4}),
    "set_4": Answer(["unknown"], {"unknown": 0.99}),
    "set_5": Answer(["speed_lag", "backlash"], {"speed_lag": 0.5}),
    "set_6": Answer(["none"], {"none": 0.9}),
    "set_7": Answer(["drawbar"], {"drawbar": 0.9, "none": 0.1}),
}


def test_score_counts_what_a_hand_counts():
    kinds = score_answers(LABELS, ANSWERS)["kinds"]
    assert list(kinds) == [
        *("single, plain", "single, faint", "pair, plain", "pair, faint", "unknown, plain", "none")
    ]
    plain, faint, pair = (kinds[each] for each in ("single, plain", "single, faint", "pair, plain"))
    assert (plain["sets"], plain["first"]["hits"], plain["missed"]["hits"]) == (2, 1, 1)
    assert plain["mean_group_size"] == 1.5
    assert plain["confidently_wrong"]["share"] == 0  # 0.9 on nothing is a miss, and no wrong effect
    assert (faint["first"]["hits"], faint["in_group"]["hits"]) == (0, 1)
    assert (faint["mean_group_size"], faint["confidently_wrong"]["hits"]) == (3, 1)
    assert kinds["none"]["false_alarms"]["share"] == 1
    assert kinds["unknown, plain"]["recognised"]["share"] == 1
    assert (pair["both"]["hits"], pair["at_least_one"]["hits"], pair["first"]["hits"]) == (0, 1, 1)
    assert pair["in_group"]["hits"] == 0
    weak = kinds["pair, faint"]
    assert (weak["sets"], weak["both"]["hits"], weak["at_least_one"]["hits"]) == (1, 0, 1)


def test_an_effect_answered_by_two_is_not_right_and_offers_more():
    two = Answer(["drawbar", "backlash"], groups=[["drawbar", "cable_spring"], ["backlash"]])
    row = score_answers({"set_1": LABELS["set_1"]}, {"set_1": two})["kinds"]["single, plain"]
    assert (row["first"]["hits"], row["in_group"]["hits"], row["mean_group_size"]) == (0, 1, 3)


@pytest.mark.parametrize(("beside", "is_told"), [(0.6, True), (0.4, False)])
def test_something_unlisted_may_be_told_beside_names(beside, is_told):
    answer = Answer(["loosening"], {"loosening": 0.6, "unknown": beside})
    row = score_answers({"set_4": LABELS["set_4"]}, {"set_4": answer})["kinds"]["unknown, plain"]
    assert (row["recognised"]["hits"], row["unknown_told"]["hits"]) == (0, int(is_told))


def test_score_of_the_truth_has_no_fault():
    truth = {
        name: Answer(label["effects"] or ["none"], {"+".join(label["effects"]) or "none": 1.0})
        for name, label in LABELS.items()
    }
    found = score_answers(LABELS, truth)
    assert found["wrong"] == []
    assert found["calibration"][-1]["right"]["hits"] == len(LABELS)
    for row in found["kinds"].values():
        assert row["first"]["share"] == 1
        assert row["in_group"]["share"] == 1


def test_confusions_and_calibration():
    found = score_answers(LABELS, ANSWERS)
    assert found["confusion"]["loosening"] == {"excavation": 1}
    assert found["confusion"]["none"] == {"drawbar": 1}
    assert found["confusion"]["cohesion + speed_lag"] == {"backlash + speed_lag": 1}
    bins = {row["from"]: row["right"] for row in found["calibration"]}
    assert (bins[0.9]["hits"], bins[0.9]["of"]) == (3, 4)
    assert (bins[0.8]["hits"], bins[0.8]["of"]) == (0, 1)
    assert (bins[0.5]["hits"], bins[0.5]["of"]) == (1, 1)
    assert (bins[0.1]["hits"], bins[0.1]["of"]) == (1, 2)
    assert bins[0.2]["of"] == 0
    apart = {row["from"]: row["right"] for row in found["calibration_without_faint"]}
    assert (apart[0.9]["hits"], apart[0.9]["of"]) == (2, 3)
    assert apart[0.8]["of"] == 0  # set_2 is faint


def test_shrinkage_is_held_against_the_promise():
    found = score_answers(LABELS, ANSWERS)["shrinkage"]["x"]
    # Of 1 and 2 mm, 0.92 and 1.92 lie above the floor, and 0.8 and 1 mm went.
    realised = [each["realised"] for each in found["sets"]]
    assert realised == pytest.approx([0.8 / 0.92, 1.0 / 1.92])
    assert (found["kept"]["hits"], found["in_interval"]["hits"]) == (1, 1)


def test_a_promise_without_an_interval_is_counted_without_one(tmp_path):
    gap = {"x": GapAnswer(1.0, 0.1, 0.08, 0.85, None)}
    answer = {"verdict": ["drawbar"], "gap": msgspec.to_builtins(gap)}
    answer["fresh"] = msgspec.to_builtins(ANSWERS["set_1"].fresh)
    write_answers(tmp_path / "answers.json", {"set_1": answer})
    read = read_answers(tmp_path / "answers.json")
    found = score_answers({"set_1": LABELS["set_1"]}, read)["shrinkage"]["x"]
    assert (found["kept"]["hits"], found["in_interval"]["of"]) == (1, 0)


def test_effects_by_which_a_fresh_run_cannot_be_simulated_break_their_promise(tmp_path):
    gap = {"x": GapAnswer(1.0, 0.1, 0.08, 0.9, (0.8, 1.0))}
    fresh = {"x": {"before_mm": 1.0, "after_mm": math.nan}}
    answer = {"verdict": ["drawbar"], "gap": msgspec.to_builtins(gap), "fresh": fresh}
    write_answers(tmp_path / "answers.json", {"set_1": answer})
    read = read_answers(tmp_path / "answers.json")
    assert read["set_1"].fresh["x"].after_mm is None
    found = score_answers({"set_1": LABELS["set_1"]}, read)["shrinkage"]["x"]
    assert (found["kept"]["hits"], found["kept"]["of"]) == (0, 1)


def test_a_file_has_null_where_there_is_no_number():
    document = {"a": math.nan, "b": [math.inf, 1.5], "c": np.float64(1e-5), "d": "ö"}
    assert json.loads(as_json(document)) == {"a": None, "b": [None, 1.5], "c": 1e-5, "d": "ö"}


def test_nothing_is_promised_of_a_gap_at_its_floor():
    faint = Answer(["drawbar"], {}, [], {"x": GapAnswer(0.1, 0.1, 0.08, 0.0, (0.0, 0.0))})
    faint.fresh = {"x": FreshAnswer(0.2, 0.1)}
    assert score_answers({"set_1": LABELS["set_1"]}, {"set_1": faint})["shrinkage"] == {}


def test_no_promise_is_tried_on_fresh_runs_at_the_floor():
    plain = Answer(["drawbar"], {}, [], {"x": GapAnswer(0.5, 0.1, 0.08, 0.9, (0.8, 1.0))})
    plain.fresh = {"x": FreshAnswer(0.1, 0.09)}
    found = score_answers({"set_1": LABELS["set_1"]}, {"set_1": plain})["shrinkage"]["x"]
    assert (found["untried"], found["sets"], found["kept"]["of"]) == (1, [], 0)


def test_settings_move_the_thresholds():
    strict = ScoreSettings(faint_floors=20.0, confident_weight=0.99, calibration_bins=5)
    found = score_answers(LABELS, ANSWERS, strict)
    assert all("faint" in kind for kind in found["kinds"] if kind != "none")
    assert all(row["confidently_wrong"]["hits"] == 0 for row in found["kinds"].values())
    assert [row["to"] for row in found["calibration"]] == [0.2, 0.4, 0.6, 0.8, 1.0]


def test_interval_of_a_share():
    # Wilson's, worked out for z = 1.6449: 8 of 10, to half a unit of the last digit.
    assert Proportion(8, 10).interval() == pytest.approx((0.5408, 0.9314), abs=0.5e-4)
    assert Proportion(0, 5).interval() == pytest.approx((0.0, 0.3511), abs=0.5e-4)
    assert Proportion(0, 0).interval() is None
    assert str(Proportion(0, 0)) == "-"


def test_sealed_labels_open_and_are_not_to_be_read_by_eye(tmp_path):
    seal(tmp_path, LABELS)
    assert open_labels(tmp_path) == LABELS
    assert b"drawbar" not in (tmp_path / SEALED_FILE).read_bytes()
    assert len((tmp_path / HASH_FILE).read_text().strip()) == 64


def test_a_seal_betrays_labels_that_were_changed(tmp_path):
    seal(tmp_path, LABELS)
    stated = (tmp_path / HASH_FILE).read_text()
    seal(tmp_path, LABELS | {"set_3": label(["drawbar"])})
    (tmp_path / HASH_FILE).write_text(stated)
    with pytest.raises(InputError, match="not what was sealed"):
        open_labels(tmp_path)
    (tmp_path / HASH_FILE).unlink()
    with pytest.raises(InputError, match="lacks"):
        open_labels(tmp_path)
    (tmp_path / SEALED_FILE).write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="damaged"):
        open_labels(tmp_path)


def test_plain_labels_are_read_too(tmp_path):
    (tmp_path / "labels.json").write_text('{"set_01": ["none"], "set_02": ["drawbar"]}')
    labels = open_labels(tmp_path)
    assert labels == {"set_01": label([]), "set_02": label(["drawbar"])}
    found = score_answers(labels, {"set_02": Answer(["drawbar"])})
    assert found["kinds"]["single"]["first"]["share"] == 1
    assert found["unanswered"] == ["set_01"]


@pytest.fixture
def sets(tmp_path):
    folder = tmp_path / "sets"
    for name in ("set_1", "set_2"):
        (folder / name / "fresh").mkdir(parents=True)
        for run in ("run_a", "run_b", "fresh/fresh_a"):
            (folder / name / f"{run}.h5").touch()
    return folder


@pytest.fixture
def blind(monkeypatch):
    """A diagnosis that counts the runs of a set, as the command `answer` finds one."""
    seen = []

    def answer_set(paths):
        seen.append([path.name for path in paths])
        return {"verdict": ["none"], "weights": {"none": 1.0}}

    module = types.ModuleType("diagnose.blind.answers.answer_set")
    module.answer_set = answer_set  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "diagnose.blind.answers.answer_set", module)
    return seen


def test_answers_see_runs_alone(sets, blind, monkeypatch):
    seal(sets, LABELS)

    def opened(folder):
        raise AssertionError("a label was opened")

    monkeypatch.setattr("diagnose.blind.generation.sealed_labels.open_labels", opened)
    with_labels = dict(answer_sets(runs_of(sets)))
    for name in (SEALED_FILE, HASH_FILE):
        (sets / name).unlink()
    assert dict(answer_sets(runs_of(sets))) == with_labels
    assert blind == [["run_a.h5", "run_b.h5"]] * 4


def test_the_module_of_answers_knows_no_labels():
    # What a module does not import, it cannot open.
    source = __import__("diagnose.blind.answers.answer", fromlist=["answer"])
    assert not any("seal" in name or "label" in name for name in vars(source))


def test_answer_and_score_from_the_command_line(sets, blind, tmp_path, monkeypatch, capsys):
    run = _app(monkeypatch, capsys)
    run("answer", sets, "-o", tmp_path / "answers.json")
    seal(sets, {"set_1": label([]), "set_2": label(["drawbar"], 10.0)})
    out = run("score", sets, "--answers", tmp_path / "answers.json", "-o", tmp_path / "score.json")
    assert "false alarms" in out
    found = json.loads((tmp_path / "score.json").read_text())
    assert found["kinds"]["none"]["false_alarms"]["hits"] == 0
    assert found["kinds"]["single, plain"]["missed"]["hits"] == 1
    assert found["wrong"] == [{"set": "set_2", "true": ["drawbar"], "answered": []}]


def test_several_folders_are_scored_as_one(tmp_path, monkeypatch, capsys):
    run = _app(monkeypatch, capsys)
    folders, files = [tmp_path / "a", tmp_path / "b"], [tmp_path / "a.json", tmp_path / "b.json"]
    for folder, file, effects in zip(folders, files, ([], ["drawbar"]), strict=True):
        folder.mkdir()
        seal(folder, {"set_1": label(effects, 10.0)})
        answers = {"set_1": {"verdict": ["drawbar"], "weights": {"drawbar": 1.0}}}
        file.write_text(json.dumps({"schema": SCHEMA, "schema_version": 1, "answers": answers}))
    each = [part for file in files for part in ("--answers", file)]
    run("score", *folders, *each, "-o", tmp_path / "score.json")
    found = json.loads((tmp_path / "score.json").read_text())
    assert found["sets"] == 2
    assert found["kinds"]["single, plain"]["first"]["hits"] == 1
    assert [each["set"] for each in found["wrong"]] == [f"{folders[0]}/set_1"]
    with pytest.raises(InputError, match="each folder needs one --answers"):
        run("score", *folders, *each[:2])
    with pytest.raises(InputError, match="given twice"):
        run("score", folders[0], folders[0], *each)


def test_of_many_sets_without_an_answer_some_are_named(tmp_path, monkeypatch, capsys):
    run = _app(monkeypatch, capsys)
    seal(tmp_path, {f"set_{number:02d}": label([]) for number in range(12)})
    answers = {"set_00": {"verdict": ["none"], "weights": {"none": 1.0}}}
    file = tmp_path / "answers.json"
    file.write_text(json.dumps({"schema": SCHEMA, "schema_version": 1, "answers": answers}))
    out = run("score", tmp_path, "--answers", file)
    assert "without an answer: set_01, set_02" in out
    assert "set_10 and 1 more" in out
    assert "set_11" not in out


def test_answers_already_in_the_file_are_kept(sets, blind, tmp_path, monkeypatch, capsys):
    run = _app(monkeypatch, capsys)
    kept = {"verdict": ["drawbar"], "weights": {"drawbar": 1.0}, "notes": ["by another program"]}
    (tmp_path / "answers.json").write_text(
        json.dumps({"schema": SCHEMA, "schema_version": 1, "answers": {"set_1": kept}})
    )
    run("answer", sets, "-o", tmp_path / "answers.json", "--resume")
    answers = json.loads((tmp_path / "answers.json").read_text())["answers"]
    assert answers["set_1"] == kept
    assert answers["set_2"]["verdict"] == ["none"]
    assert len(blind) == 1


def _dies(runs):
    if runs == [Path("die")]:
        os._exit(1)
    return {"verdict": [run.name for run in runs]}


def test_processes_are_replaced_and_one_that_dies_spoils_no_more_than_its_own_sets(monkeypatch):
    monkeypatch.setattr("diagnose.blind.answers.answer.answer_one", _dies)
    sets = {f"set_{each:02}": [Path(f"run_{each}")] for each in range(9)}
    sets["set_99"] = [Path("die")]
    found = dict(answer_sets(sets, 2))
    assert set(found) == set(sets)
    assert all(found[f"set_{each:02}"] == {"verdict": [f"run_{each}"]} for each in range(8))
    assert "died" in found["set_99"]


WAITS = """
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import os
from diagnose.blind.answers.answer import configure_helper

if __name__ == "__main__":
    with ProcessPoolExecutor(1, get_context("spawn"), configure_helper, (set(),)) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60)
"""


def test_a_helping_process_ends_when_its_parent_is_killed(tmp_path):
    (tmp_path / "waits.py").write_text(WAITS)
    with subprocess.Popen(
        [sys.executable, tmp_path / "waits.py"], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        helper = int(parent.stdout.readline())
        parent.kill()
    until = time.monotonic() + 20
    while _lives(helper) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _lives(helper)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    # One that ended but that nobody has asked after is a zombie.
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"


def test_refusals_are_one_sentence(sets, tmp_path, monkeypatch, capsys):
    run = _app(monkeypatch, capsys)
    empty = '{"schema": "drft-blind-answers", "schema_version": 1, "answers": {}}'
    (tmp_path / "answers.json").write_text(empty)
    with pytest.raises(InputError, match="nothing to open"):
        run("score", sets, "--answers", tmp_path / "answers.json")
    (tmp_path / "other.json").write_text('{"schema": "other"}')
    with pytest.raises(InputError, match="holds no answers"):
        run("score", sets, "--answers", tmp_path / "other.json")
    (tmp_path / "text.h5").write_text("answers")
    with pytest.raises(InputError, match=r"must end in \.json$"):
        run("score", sets, "--answers", tmp_path / "text.h5")
    with pytest.raises(InputError, match="is not empty"):
        run("make", sets, "--sets", 1)
    with pytest.raises(InputError, match="protocol"):
        run("make", tmp_path / "new", "--protocol", "other")
    with pytest.raises(InputError, match="no sets"):
        runs_of(tmp_path / "sets" / "set_1" / "fresh")


def _app(monkeypatch, capsys):
    """The subcommand `blind` alone, as `drft` calls it."""
    Drft(monkeypatch, capsys)

    def run(*arguments) -> str:
        capsys.readouterr()
        app(list(map(str, arguments)), standalone_mode=False)
        return capsys.readouterr().out

    return run
