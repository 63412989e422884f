"""Linear fits of several coefficients within their bounds."""

import numpy as np
import pytest

from diagnose.change.differences.fit import CoefficientPrior, _solve
from diagnose.linear.linear_fit import GramMatrices, fit_linear

# Two columns that look alike, and both make up for a residual only by less than nothing.
ALIKE, RIGHT = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([-1.0, -0.5])
# The ridge that keeps columns apart.
RIDGE = 1e-8


def products() -> GramMatrices:
    """One run and block, whose zeta moves nothing, with a residual that leads to `RIGHT`."""
    gram = np.zeros((4, 4))
    gram[1:3, 1:3] = ALIKE
    gram[1:3, 3] = gram[3, 1:3] = -RIGHT
    gram[3, 3] = 10.0
    return GramMatrices((("z", "slow"),), gram[None, None], np.array([[4]]), np.zeros(1))


def test_no_coefficient_comes_below_its_bound_because_another_is_held():
    assert np.linalg.solve(ALIKE, RIGHT)[1] > 0, "only the first is below its bound at first"
    line = fit_linear(products(), [0, 1], lower=np.zeros(2), linear_error=0.0)
    assert line.coefficients == pytest.approx([0.0, 0.0])


def test_neither_in_a_comparison():
    gram = np.zeros((3, 3))
    gram[:2, :2] = ALIKE
    gram[:2, 2] = -RIGHT
    bounds = CoefficientPrior(np.full(2, 1e6), np.zeros(2), np.zeros(2), np.full(2, np.inf))
    found = _solve(gram, np.zeros((0, 0)), np.zeros(0), bounds)
    assert found == pytest.approx([0.0, 0.0], abs=RIDGE)


def test_a_response_beyond_the_range_of_numbers_comes_last():
    matrices = products()
    matrices.gram[..., 2, 2] = np.inf
    with np.errstate(invalid="ignore", over="ignore"):
        assert fit_linear(matrices, [1], linear_error=0.0).score == -np.inf
