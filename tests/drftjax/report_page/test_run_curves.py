"""Curves as a page holds them: the values that were given, thinned to a small page."""

import json

import numpy as np
import pytest

from drftjax.report_page.page import render_page
from drftjax.report_page.run_curves import (
    CurveLabels,
    CurvePanel,
    CurveSettings,
    RunCurves,
    RunPanels,
    channel_panel,
    curve_document,
)

# A page is to stay under two million: half is left to its figures.
MOST_CHARACTERS = 1_000_000
FLOOR = 3e-5
TIME = np.linspace(0.0, 30.0, 3001)
# Rounding leaves half of a last place: that of a twentieth of the noise floor, or finer.
ROUNDING = 0.05 * FLOOR * 1e3


def run_named(name: str, time: np.ndarray = TIME) -> RunPanels:
    z = -0.02 + 0.003 * np.sin(time)
    x = 0.01 * time
    panels = [
        channel_panel("z", "mm", 1e3, z, 0.1 * z, 0.01 * z, FLOOR),
        channel_panel("x", "mm", 1e3, x, 0.1 * x, None, FLOOR),
    ]
    return RunPanels(name, time, panels)


def test_height_becomes_sinkage_in_mm_and_residuals_turn_with_it():
    (run,) = curve_document(RunCurves([run_named("a")], CurveLabels()))["runs"]
    sinkage, travel = run["panels"]
    assert (sinkage["quantity"], sinkage["downward"]) == ("sinkage", True)
    assert (travel["quantity"], travel["downward"]) == ("travel", False)
    expected = 20 - 3 * np.sin(TIME)
    np.testing.assert_allclose(sinkage["recorded"], expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(sinkage["before"], 0.1 * expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(travel["before"], TIME, rtol=0, atol=ROUNDING)
    assert travel["after"] is None
    assert sinkage["floor"] == pytest.approx(1e3 * FLOOR)
    assert run["every"] == 1


@pytest.mark.parametrize("count", [1, 16, 150])
def test_a_page_stays_small_for_any_number_of_runs(count):
    curves = RunCurves([run_named(f"run {k}") for k in range(count)], CurveLabels())
    found = curve_document(curves)
    assert len(json.dumps(found)) < MOST_CHARACTERS
    assert len(found["runs"]) == count
    every = found["runs"][0]["every"]
    assert found["runs"][-1]["time"] == pytest.approx(TIME[::every])


def test_runs_that_would_leave_too_few_samples_are_counted_and_not_drawn():
    settings = CurveSettings(max_values=6 * 100 * 3, min_points=100)
    curves = RunCurves([run_named(f"run {k}") for k in range(5)], CurveLabels())
    found = curve_document(curves, settings)
    assert [each["name"] for each in found["runs"]] == ["run 0", "run 1", "run 2"]
    assert found["left_out"] == 2


def test_what_is_not_finite_leaves_a_gap_and_the_page_holds_valid_json():
    values = np.array([1.0, np.nan, np.inf, -0.0])
    panel = CurvePanel("torque", "N m", values, None, values, np.nan)
    curves = RunCurves([RunPanels("a\x1b[31m", np.arange(4.0), [panel])], CurveLabels())
    document = json.loads(json.dumps(curve_document(curves), allow_nan=False))
    (run,) = document["runs"]
    assert run["name"] == "a\ufffd[31m"
    (found,) = run["panels"]
    assert found["recorded"] == [1.0, None, None, 0.0]
    assert str(found["recorded"][3]) == "0.0"
    assert found["floor"] is None


def test_a_name_can_close_no_element_of_the_page():
    hostile = "</script><script>alert(1)</script><!--"
    curves = RunCurves([run_named(hostile)], CurveLabels(before=hostile))
    text = render_page("drftjax.report_page", "curves.html", curves) + render_page(
        "drftjax.report_page", "page.html", curves
    )
    assert hostile not in text
    assert "alert(1)</script>" not in text
    data = text.split('id="curves">')[1].split("</script>")[0]
    assert json.loads(data)["runs"][0]["name"] == hostile
