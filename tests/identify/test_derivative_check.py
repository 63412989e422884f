"""A fit says where one finite difference contradicts the derivatives that it went by."""

from dataclasses import replace

import numpy as np
import pytest

from identify.fit_constant import fit
from identify.parameters.parameter import parameter
from identify.uncertainty.derivative_check import (
    DerivativeCheckSettings,
    derivative_doubts,
    derivative_errors,
)
from tests.helpers.synthetic_runs import SLOW, coarse, recorded, setup_of

# A secant over half a per cent passes corners, where a plate enters the sand or begins to lead.
CORNERS = 0.05


@pytest.fixture(scope="module")
def fitted():
    runs = [coarse(name, recorded(setup_of(SLOW, 0.75), 3)) for name in ("one", "other")]
    return fit(runs, [parameter("zeta", shared=False)])


def test_derivatives_of_a_rolling_wheel_are_borne_out(fitted):
    estimate = fitted.estimate
    start = estimate.problem.start()
    every = DerivativeCheckSettings(least=0)
    errors = derivative_errors(estimate.problem, estimate.solution, start, every)
    assert np.all(errors[:2] < CORNERS)
    assert np.all(errors[:2] > 0)
    assert not any("derivatives say" in each for each in fitted.findings)


def test_wrong_derivatives_of_a_run_are_told_with_its_name(fitted):
    estimate = fitted.estimate
    blocks = estimate.solution.blocks.copy()
    blocks[1] *= 2  # twice as steep as it is: half of what is predicted does not come
    wrong = replace(estimate.solution, blocks=blocks)
    (doubt,) = derivative_doubts(estimate.problem, wrong, estimate.problem.start(), estimate.runs)
    assert doubt.startswith("other: over a small step")
    assert "by 50 %" in doubt or "by 49 %" in doubt or "by 51 %" in doubt


def test_a_fit_that_ends_where_it_began_is_not_judged(fitted):
    solution = fitted.estimate.solution
    errors = derivative_errors(fitted.estimate.problem, solution, solution.coordinates)
    assert not errors.any()
