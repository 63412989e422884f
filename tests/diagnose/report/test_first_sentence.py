"""The first sentence of a report, where it must not soothe."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnose.checks.outlier_runs import REPEATS_DIFFER
from diagnose.report.text import group_sentences, next_sentences, verdict


def found(runs: int, notes: list[str], gap: float = 1.0):
    gaps = {"x": SimpleNamespace(before=gap, floor=1.0)}
    return SimpleNamespace(
        verdict=("none",),
        weights={"none": 0.9},
        groups=[["none", "drawbar"]],
        gap=gaps,
        notes=notes,
        dataset=SimpleNamespace(runs=list(range(runs))),
    )


def test_repeats_that_disagree_are_no_good_news():
    told = verdict(found(2, [f"a and b {REPEATS_DIFFER} 40 mm in x"]))  # pyright: ignore
    assert "can say nothing of the model" in told
    assert "follows" not in told
    assert "follows" in verdict(found(2, []))  # pyright: ignore


@pytest.mark.parametrize(
    ("runs", "tell", "rule"),
    [
        (1, "this run tells", "What this run rules out least"),
        (3, "these runs tell", "What these runs rule out least"),
    ],
)
def test_one_run_is_spoken_of_as_one(runs, tell, rule):
    told = found(runs, [], gap=9.0)
    assert f"but {tell} too little of why" in verdict(told)  # pyright: ignore
    assert group_sentences(told)[0].startswith(rule)  # pyright: ignore


@pytest.mark.parametrize(
    ("weight", "end"),
    [(0.97, "a, b and c."), (0.6, "a, b and c, the least sure of them with weight 60%.")],
)
def test_of_several_effects_the_least_sure_is_told(weight, end):
    told = found(3, [])
    told.verdict, told.weights = ("a", "b", "c"), {"a": 0.99, "b": weight, "c": 0.99}
    assert verdict(told) == f"These runs show 3 effects at once: {end}"  # pyright: ignore


def test_advice_on_the_next_run_is_in_words_whatever_its_numbers_are_of():
    better = {
        "run": "run_a again at 8 times the speed",
        "channel": "x",
        "difference": np.float64(2.345),
        "unit": "mm",
        "floors": np.float64(46.9),
    }
    advice = {"tells": ["drawbar+brake", "none"], "run": better, "channel": None}
    assert next_sentences(SimpleNamespace(next_run=advice)) == [  # pyright: ignore
        "To tell drawbar with brake from the reference model: run run_a again at 8 times the "
        "speed, where x differs by 2.35 mm (46.9 noise floors)."
    ]
    nothing = SimpleNamespace(next_run={**advice, "run": None})
    assert next_sentences(nothing) == [  # pyright: ignore
        "No variation of these runs would tell drawbar with brake from the reference model."
    ]
    assert next_sentences(SimpleNamespace(next_run={})) == []  # pyright: ignore
