"""The first sentence of a report, where it must not soothe."""

from types import SimpleNamespace

import pytest

from diagnose.checks.outlier_runs import REPEATS_DIFFER
from diagnose.report.text import group_sentences, verdict


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
