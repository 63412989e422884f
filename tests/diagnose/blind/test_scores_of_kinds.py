"""Scores of answers to sets of several effects, of a change and of a sweep, counted by hand."""

import pytest
from rich.console import Console

from diagnose.blind.answers.answer_file import (
    Answer,
    BudgetAnswer,
    ChannelBudgetAnswer,
    GapAnswer,
    NumberAnswer,
    ShareAnswer,
    read_answers,
    write_answers,
)
from diagnose.blind.scoring.score import score_answers
from diagnose.blind.scoring.table import tables


def gap(before: float, after: float) -> GapAnswer:
    return GapAnswer(before, after, 0.05, 0.5, None)


def shares(floor: float, **effects: float) -> ChannelBudgetAnswer:
    return ChannelBudgetAnswer(floor, {name: ShareAnswer(share) for name, share in effects.items()})


SEVERAL = {
    "kind": "several",
    "effects": ["drawbar", "sinkage_gain", "loosening"],
    "budget": {
        "channels": {
            "x": {
                "before": 2.0,
                "effects": {
                    "drawbar": {"share": 0.8},
                    "sinkage_gain": {"share": 0.0},
                    "loosening": {"share": 0.2},
                },
            },
            "z": {
                "before": 1.0,
                "effects": {
                    "drawbar": {"share": -0.05},
                    "sinkage_gain": {"share": 0.7},
                    "loosening": {"share": 0.35},
                },
            },
        }
    },
}


def test_several_effects_are_counted_one_by_one():
    answer = Answer(
        ["drawbar", "excavation", "cohesion"],
        {"drawbar": 0.99, "cohesion": 0.85, "excavation": 0.6},
        [["excavation", "loosening"], ["drawbar", "horizontal_coulomb"]],
        {"x": gap(2.0, 0.3), "z": gap(1.0, 1.1)},
        budget=BudgetAnswer({"x": shares(0.1, drawbar=0.75, cohesion=0.15)}),
    )
    row = score_answers({"s": SEVERAL}, {"s": answer})["kinds"]["several"]
    # drawbar is named, loosening is in a group, sinkage_gain is neither.
    assert (row["effects_offered"]["hits"], row["effects_offered"]["of"]) == (2, 3)
    assert row["in_group"]["hits"] == 0
    assert row["confidently_wrong"]["hits"] == 1
    # Over 0.8 are drawbar, which is there, and cohesion, which is not.
    assert (row["false_names"]["hits"], row["false_names"]["of"]) == (1, 2)
    assert (row["worse_channels"]["hits"], row["worse_channels"]["of"]) == (1, 2)
    # In x: drawbar and sinkage_gain within 0.1, loosening (0 of 0.2) and cohesion (0.15 of 0) not;
    # in z, of which the budget says nothing, only drawbar's share is as small as that.
    assert (row["budget_shares"]["hits"], row["budget_shares"]["of"]) == (3, 7)


def test_a_group_has_one_joint_share():
    answer = Answer(
        ["excavation", "drawbar"],
        {},
        [["excavation", "loosening"], ["drawbar", "sinkage_gain"]],
        budget=BudgetAnswer({"z": shares(0.1, excavation=0.32, drawbar=0.6)}),
    )
    label = {**SEVERAL, "budget": {"channels": {"z": SEVERAL["budget"]["channels"]["z"]}}}
    row = score_answers({"s": label}, {"s": answer})["kinds"]["several"]
    # excavation stands for loosening (0.32 of 0.35); drawbar, which is there, for itself alone
    # (0.6 of -0.05), and sinkage_gain is missed (0 of 0.7).
    assert (row["budget_shares"]["hits"], row["budget_shares"]["of"]) == (1, 3)


def test_no_share_is_asked_of_a_channel_without_a_gap_nor_of_an_answer_without_a_budget():
    quiet = Answer(["drawbar"], budget=BudgetAnswer({"x": shares(1.9), "z": shares(0.9)}))
    row = score_answers({"s": SEVERAL}, {"s": quiet})["kinds"]["several"]
    assert row["budget_shares"]["of"] == 0
    none = score_answers({"s": SEVERAL}, {"s": Answer(["drawbar"])})["kinds"]["several"]
    assert none["budget_shares"]["of"] == 0


def number(**values: float) -> dict[str, NumberAnswer]:
    return {name: NumberAnswer(value) for name, value in values.items()}


def test_the_size_of_a_change_counts_where_the_change_is_named():
    def label(effects: list[str], **rest: object) -> dict:
        return {"kind": "change", "effects": effects, "floors": 10.0, **rest}

    def size(value: float, *numbers: str) -> dict:
        return {"value": value, "unit": "-", "numbers": list(numbers)}

    labels = {
        "near": label(["wheel_radius"], size=size(-0.002, "excess")),
        "sign": label(["wheel_radius"], size=size(-0.002, "excess")),
        "sand": label(["zeta"], size=size(0.1, "change")),
        "vector": label(["speed_ripple"], size=size(0.05, "cosine", "sine")),
        "other": label(["drawbar"], size=size(5.0, "force")),
        "shape": label(["terrain_variation"]),
        "none": {"kind": "change", "effects": []},
        "alarm": {"kind": "change", "effects": []},
    }
    answers = {
        "near": Answer(["wheel_radius"], parameters={"wheel_radius": number(excess=-0.0017)}),
        "sign": Answer(["wheel_radius"], parameters={"wheel_radius": number(excess=0.002)}),
        "sand": Answer(["zeta"], parameters={"zeta": number(change=0.13)}),
        # Another form of the effect, which reports under its name.
        "vector": Answer(
            ["speed_ripple"],
            parameters={"speed_harmonics": number(cosine=0.03, sine=-0.04, cosine2=0.01)},
        ),
        "other": Answer(["cable_spring"], parameters={"cable_spring": number(stiffness=5.0)}),
        "shape": Answer(["terrain_variation"]),
        "none": Answer(["none"], {"none": 0.9}),
        "alarm": Answer(["zeta"], {"zeta": 0.9}),
    }
    kinds = score_answers(labels, answers)["kinds"]
    assert list(kinds) == ["change, plain", "change, none"]
    row = kinds["change, plain"]
    assert (row["first"]["hits"], row["first"]["of"]) == (5, 6)
    assert (row["size"]["hits"], row["size"]["of"]) == (2, 4)
    assert kinds["change, none"]["false_alarms"]["hits"] == 1
    assert kinds["change, none"]["confidently_wrong"]["hits"] == 1


def test_sweeps_count_first_and_group_and_all_kinds_share_one_calibration():
    labels = {
        "a": {"kind": "sweep", "effects": ["force_gain"], "floors": 9.0},
        "b": {"kind": "sweep", "effects": ["heap"], "floors": 1.0},
        "c": {"kind": "sweep", "effects": []},
        "d": SEVERAL,
        "e": {"effects": ["drawbar"], "floors": 9.0},
    }
    answers = {
        "a": Answer(["force_gain"], {"force_gain": 0.85}),
        "b": Answer(["cohesion"], {"cohesion": 0.82}, [["cohesion", "heap"]]),
        "c": Answer(["none"], {"none": 0.88}),
        "d": Answer(["loosening"], {"loosening": 0.81}),
        "e": Answer(["drawbar"], {"drawbar": 0.5}),
    }
    found = score_answers(labels, answers)
    kinds = found["kinds"]
    assert list(kinds) == [
        *("single, plain", "several", "sweep, plain", "sweep, faint", "sweep, none")
    ]
    assert kinds["sweep, plain"]["first"]["hits"] == 1
    assert (kinds["sweep, faint"]["first"]["hits"], kinds["sweep, faint"]["in_group"]["hits"]) == (
        *(0, 1),
    )
    bins = {row["from"]: row["right"] for row in found["calibration"]}
    assert (bins[0.8]["hits"], bins[0.8]["of"]) == (3, 4)


def test_the_tables_show_the_scores_of_all_kinds(capsys):
    answer = Answer(["drawbar"], budget=BudgetAnswer({"x": shares(0.1, drawbar=0.8)}))
    change = {"kind": "change", "effects": ["zeta"], "floors": 9.0}
    change["size"] = {"value": 0.1, "unit": "-", "numbers": ["change"]}
    told = Answer(["zeta"], parameters={"zeta": number(change=0.1)})
    score = score_answers({"a": SEVERAL, "b": change}, {"a": answer, "b": told})
    console = Console(width=120)
    for table in tables(score):
        console.print(table)
    shown = capsys.readouterr().out
    for words in ("effects named or in a group", "shares within 10 points", "size within 20 %"):
        assert words in shown


def test_budget_and_numbers_are_read_back_from_a_file(tmp_path):
    document = {
        "verdict": ["drawbar"],
        "parameters": {"drawbar": {"force": {"value": 5.0, "error": 0.1, "unit": "N"}}},
        "budget": {
            "channels": {
                "z": {
                    "before": 1.0,
                    "after": 0.1,
                    "floor": 0.03,
                    "effects": {"drawbar": {"share": 0.9, "interval": [0.8, 0.95]}},
                    "remainder": 0.1,
                    "chance": 0.01,
                }
            }
        },
    }
    write_answers(tmp_path / "answers.json", {"s": document})
    answer = read_answers(tmp_path / "answers.json")["s"]
    assert answer.parameters["drawbar"]["force"].value == pytest.approx(5.0)
    assert answer.budget is not None
    assert answer.budget.channels["z"].effects["drawbar"].share == pytest.approx(0.9)
