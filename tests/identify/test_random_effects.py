"""What runs scatter by: values of their own, and a zeta that they share."""

import re
from dataclasses import replace

import numpy as np
import pytest

from drftjax.results.random_effects import paule_mandel
from identify.fit_constant import fit
from identify.parameters.parameter import own, shared
from tests.helpers.synthetic_runs import coarse, recorded, setup_of

# Runs whose sands differ by 2 %, as repeats on a bed that is prepared again.
ZETAS = (0.74, 0.755)
# Between two values that are told alike the best one value lies halfway; sums of squares that are
# no parabolas move it by a few per cent of the way.
HALFWAY = 0.1
# 400 draws tell a standard deviation to 4 %; noise that follows itself scatters less over so short
# a run than the formula for long ones says. And the scatter of two, less a fifth that errors make.
SCATTER = 0.25
# The error of a share of 5 % of 2,000 is 0.5 %; three times that.
CHANCE = 0.015
# The mean of 300 variances of eight values that count is told to 3 %; three times that.
VARIANCE = 0.1


@pytest.fixture(scope="module")
def runs():
    return [
        coarse(f"run {number}", recorded(setup_of(zeta=zeta), seed=number))
        for number, zeta in enumerate(ZETAS)
    ]


@pytest.fixture(scope="module")
def together(runs):
    return fit(runs, [shared("zeta")])


def test_a_shared_zeta_leaves_no_run_out(together):
    (zeta,) = together.shared.values()
    way = (zeta.value - ZETAS[0]) / (ZETAS[1] - ZETAS[0])
    assert way == pytest.approx(0.5, abs=HALFWAY)
    assert together.status == "converged"


def test_the_error_of_a_shared_zeta_counts_in_what_runs_scatter_by(together):
    (zeta,) = together.shared.values()
    # The error of a mean of two is half of what they differ by.
    assert zeta.error == pytest.approx(np.ptp(ZETAS) / 2, rel=HALFWAY)
    drawn = together.bootstrap(400, seed=3).bootstraps[0]
    # Without what runs scatter by it is 0.57 of that.
    assert drawn.error[0] == pytest.approx(zeta.error, rel=SCATTER)
    (told,) = (each for each in together.findings if "scatter" in each)
    (size,) = re.findall(r"zeta of each run alone would scatter by (\S+) %, which the error", told)
    true = 100 * np.std(ZETAS, ddof=1) / np.mean(ZETAS)
    assert float(size) == pytest.approx(true, rel=SCATTER)
    (floor,) = (each for each in together.findings if each.startswith("repeated runs"))
    assert floor.endswith("what their sands differ by included")


def test_a_zeta_of_each_run_counts_in_nothing(runs):
    apart = fit(runs, [own("zeta")])
    for run, zeta in zip(apart.runs, ZETAS, strict=True):
        (found,) = run.values.values()
        assert abs(found.value - zeta) < 4 * found.error
        # A twentieth of what they differ by, as alone.
        assert found.error < 0.1 * np.ptp(ZETAS)
    (floor,) = (each for each in apart.findings if each.startswith("repeated runs"))
    assert floor.endswith("beyond their own values: the noise floor")


def test_a_zeta_that_no_run_tells_is_no_error():
    run = recorded(setup_of())
    absurd = {name: np.array(getattr(run.measured, name)) for name in ("x", "z")}
    for values in absurd.values():
        values[values.size // 2 :] = 2e3
    far = replace(run, measured=replace(run.measured, **absurd))
    found = fit([coarse("absurd", far)], [shared("zeta")])
    assert any(each.startswith("zeta cannot be identified") for each in found.findings)


def test_chance_alone_is_told_as_scatter_in_one_of_twenty_cases():
    random = np.random.default_rng(5)
    errors = np.geomspace(1.0, 30.0, 6)
    told = [
        paule_mandel(errors * random.standard_normal(6), errors).identified for _ in range(2000)
    ]
    assert np.mean(told) == pytest.approx(0.05, abs=CHANCE)


def test_a_value_that_is_hardly_told_hides_no_scatter():
    random = np.random.default_rng(6)
    errors = np.r_[np.full(8, 0.05), 5.0]
    found = [
        paule_mandel(random.standard_normal(9) + errors * random.standard_normal(9), errors)
        for _ in range(300)
    ]
    assert all(each.identified for each in found)
    assert np.mean([each.variance for each in found]) == pytest.approx(1.0, rel=VARIANCE)


def test_values_that_agree_scatter_by_nothing():
    alike = paule_mandel(np.array([1.0, 1.01]), np.array([0.1, 0.1]))
    assert (alike.variance, alike.identified) == (0.0, False)
    alone = paule_mandel(np.array([0.7]), np.array([0.1]))
    assert (alone.mean, alone.variance, alone.identified) == (0.7, 0.0, False)
    assert alone.error == pytest.approx(0.1)
    assert paule_mandel(np.array([]), np.array([])).error == np.inf
