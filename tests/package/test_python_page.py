"""The page docs/guide/python.md: its blocks run, and their results meet what is known of them."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import drftjax as dj

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "guide" / "python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)

LONGEST = 5  # lines of an example, blank ones left out

# A fit's errors are one standard deviation, and its model has the step's error beside.
ERRORS = 5

# The same program at other numbers, but for the order of sums.
ROUNDING = 1e-12

# Plates that begin to lead within a difference make its slope stepped, by some percent.
SLOPE = 0.05


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> dict:
    """Names that the blocks of the page leave behind, run in order in one folder."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "data").symlink_to(ROOT / "data")
    names: dict = {"__name__": "page"}
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("error")
        patch.chdir(folder)
        for block in BLOCKS:
            exec(compile(block, "python.md", "exec"), names)
    return names | {"folder": folder}


@pytest.mark.parametrize("block", BLOCKS)
def test_examples_are_short(block):
    assert len([line for line in block.splitlines() if line.strip()]) <= LONGEST


def test_figures_and_run_are_written(page):
    written = {path.name for path in page["folder"].iterdir()}
    assert {"run.png", "run.h5", "sweep.png", "slip.png", "fit.png", "gap.png"} <= written


def test_mistake_is_told_in_one_sentence():
    with pytest.raises(dj.InputError, match=r"^zeta is -0.8, must lie between 0 and 1000$"):
        dj.Terrain(zeta=-0.8)  # pyright: ignore[reportArgumentType]


def test_fit_finds_the_zeta_of_the_simulated_run(page):
    zeta = page["zeta"]
    assert abs(zeta.value - 0.7) < ERRORS * zeta.error
    row = page["result"].to_dataframe().loc["zeta of a"]
    assert (row.value, row.error) == (zeta.value, zeta.error)
    assert repr(page["result"]).startswith("<FitResult of 1 run, converged: zeta of a = 0.70")


def test_diagnosis_finds_the_load_and_its_size(page):
    found = page["found"]
    force = found.parameters["drawbar"]["force"]
    assert found.verdict == ("drawbar",)
    assert abs(force.value - 8.0) < ERRORS * force.error
    assert f"drawbar (weight 1.00), drawbar.force = {str(force.value)[:5]}" in repr(found)
    data = found.to_xarray()
    assert data.value.sel(parameter="drawbar.force") == force.value
    assert float(data.gap_after.sel(channel="x")) == found.gap["x"].after
    frame = found.to_dataframe()
    assert frame.index[0] == "drawbar"
    assert frame.in_verdict.tolist().count(True) == 1


def test_own_effect_is_the_same_as_more_zeta(page):
    truth = dj.simulate(page["setup"], zeta=0.78 * 1.1)
    for name, values in truth.measured.channels().items():
        scale = np.abs(values).max()
        given = getattr(page["denser"].measured, name)
        assert given == pytest.approx(values, abs=1e3 * ROUNDING * scale)
    swept = page["swept_gain"]["z"]
    assert swept[1] == pytest.approx(page["denser"].measured.z, abs=ROUNDING)
    assert np.abs(swept[0] - swept[1]).max() > 1e-3


def test_gradient_meets_a_finite_difference(page):
    slope = float(page["jax"].grad(page["final_sinkage"])(0.78))
    ends = [float(page["final_sinkage"](0.78 + step)) for step in (-0.05, 0.05)]
    assert slope == pytest.approx((ends[1] - ends[0]) / 0.1, rel=SLOPE)
    forward = page["jax"].jacfwd(page["final_sinkage"])(0.78)
    assert float(forward) == pytest.approx(slope, rel=1e-6)


def test_every_public_name_is_on_its_page():
    listed = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    assert not {name for name in dj.__all__ if f"`{name}`" not in listed}
