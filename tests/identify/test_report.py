"""The report page of a fit."""

import json
import math
import re

import numpy as np
import pytest

from identify.results.report import answer, misfit_sentence, page
from identify.results.result import write_with_report
from tests.helpers.handmade_fit import handmade_fit

HOSTILE = "<img src=x onerror=alert(1)>"
# Values are rounded to a twentieth of the noise floor of 0.04 mm, or finer.
ROUNDING = 2e-3
# An RMS over 1600 samples of noise, which the line is a little correlated with [mm].
CHANCE = 4e-3


def test_the_answer_holds_shared_values_and_statuses():
    found = handmade_fit(["a", "b"])
    assert answer(found) == "Fitted to 2 runs: lambda = 1.120 ± 0.030. Status: converged."
    # The model was off by a line from zero to 2 mm in x and to 1 mm in z, and is off by the noise.
    told = [float(each) for each in re.findall(r"\d\.\d+", misfit_sentence(found))]
    expected = [2 / math.sqrt(3), 0.04, 1 / math.sqrt(3), 0.04]
    assert told == pytest.approx(expected, abs=CHANCE)


def test_the_page_holds_every_run_and_escapes_its_name():
    found = handmade_fit(["slow", HOSTILE], samples=200)
    text = page(found, "fit.v2")
    assert HOSTILE not in text
    assert "&lt;img src=x onerror=alert(1)&gt;" in text
    assert "left out: lost.h5: it holds no sinkage" in text
    assert "Numbers: fit.v2.json; channels: fit.v2.h5." in text
    assert "<td>0.7100 ± 0.0020</td>" in text
    curves = json.loads(text.split('id="curves">')[1].split("</script>")[0])
    assert [run["name"] for run in curves["runs"]] == ["slow", HOSTILE]
    sinkage, travel = curves["runs"][1]["panels"]
    run = found.runs[1]
    expected = 1e3 * (run.recorded[1] - run.after[1])
    np.testing.assert_allclose(sinkage["after"], expected, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(travel["recorded"], 1e3 * run.recorded[0], rtol=0, atol=ROUNDING)
    assert travel["floor"] == pytest.approx(0.04)


def test_the_page_is_written_beside_the_other_files(tmp_path):
    stem = tmp_path / "out" / "fit.v2"
    written = write_with_report(handmade_fit(["a"], samples=50), stem)
    endings = [path.name.removeprefix("fit.v2") for path in written]
    assert endings == [".json", ".h5", ".png", ".html"]
    assert (tmp_path / "out" / "fit.v2.html").read_text().startswith("<!doctype html>")
