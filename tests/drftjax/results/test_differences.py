"""Differences of two results: known changes, told by place and size."""

import copy
import math

import pytest

from drftjax.results.differences import DIFFERENCE_SETTINGS, compare_results

BEFORE = {
    "schema": "drft-fit",
    "provenance": {"date": "then"},
    "status": "converged",
    "shared": {"lambda": {"value": 2.0, "error": 0.5, "unit": "-", "at_bound": False}},
    "findings": ["a", "b"],
    "covariance": {"values": [[4.0, 1.0], [1.0, None]]},
    "runs": [{"name": "one", "rmse": 3.0}, {"name": "two", "rmse": 0.0}],
    "steps": 7,
}


def after(change) -> dict:
    """Copy with one change."""
    document = copy.deepcopy(BEFORE)
    change(document)
    return document


def test_a_copy_made_later_differs_in_nothing():
    found = compare_results(BEFORE, after(lambda d: d.update(provenance={"date": "now"})))
    # value, error, the four of the covariance, two rmse, steps
    assert (found.numbers, found.rounded, found.differences) == (9, 0, ())


@pytest.mark.parametrize(
    ("change", "place", "relative", "errors"),
    [
        (
            lambda d: d["shared"]["lambda"].update(value=3.0),
            "shared.lambda.value",
            1 / 3,
            2.0,
        ),
        (lambda d: d["runs"][0].update(rmse=2.0), "runs[one].rmse", 1 / 3, None),
        (
            lambda d: d["runs"].reverse() or d["runs"][1].update(rmse=6.0),
            "runs[one].rmse",
            0.5,
            None,
        ),
        (lambda d: d["covariance"]["values"][0].__setitem__(1, 3.0), "[0][1]", 0.5, None),
        (lambda d: d["covariance"]["values"][1].__setitem__(1, 9.0), "[1][1]", math.inf, None),
        (lambda d: d.update(steps=14), "steps", 0.5, None),
    ],
)
def test_a_number_that_moves_is_told_by_its_size(change, place, relative, errors):
    (found,) = compare_results(BEFORE, after(change)).differences
    assert found.place.endswith(place)
    assert found.relative == pytest.approx(relative)
    assert found.errors == (errors if errors is None else pytest.approx(errors))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d.update(status="stalled"), ("status", "converged", "stalled")),
        (lambda d: d["shared"]["lambda"].update(at_bound=True), ("at_bound", "False", "True")),
        (lambda d: d["findings"].append("c"), ("findings", "-", "c")),
        (lambda d: d["findings"].remove("a"), ("findings", "a", "-")),
        (lambda d: d.pop("steps"), ("steps", "7", "-")),
        (lambda d: d["runs"].pop(), ("runs[two]", "a table of 2 entries", "-")),
        (lambda d: d.update(steps=None), ("steps", "7", "-")),
        (lambda d: d.update(steps=10**400), ("steps", "7", str(10**400))),
    ],
)
def test_a_text_or_an_entry_that_changes_is_told(change, told):
    (found,) = compare_results(BEFORE, after(change)).differences
    assert (found.place.endswith(told[0]), found.before, found.after) == (True, *told[1:])
    assert found.relative is None


def test_rounding_is_no_difference_and_more_is():
    noise = DIFFERENCE_SETTINGS.relative

    def moved(by: float):
        return compare_results(BEFORE, after(lambda d: d["runs"][0].update(rmse=3.0 * (1 + by))))

    small, large = moved(noise / 2), moved(2 * noise)
    assert (small.rounded, small.differences) == (1, ())
    assert small.largest_rounding == pytest.approx(noise / 2, rel=1e-3)
    assert len(large.differences) == 1


def test_a_value_near_zero_is_measured_by_its_error():
    zero = {"pull": {"value": 1e-13, "error": 1.0}}
    moved = {"pull": {"value": -2e-13, "error": 1.0}}
    assert not compare_results(zero, moved).differences


def test_the_weightiest_difference_stands_first():
    def change(document):
        document["steps"] = 14
        document["shared"]["lambda"]["value"] = 2.1
        document["status"] = "stalled"

    found = compare_results(BEFORE, after(change)).differences
    assert [each.place for each in found] == ["shared.lambda.value", "status", "steps"]
