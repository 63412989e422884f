"""Agreement of several values of one quantity with their standard errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import chi2


@dataclass(frozen=True)
class Agreement:
    r"""Scatter of values beside their errors.

    Attributes:
        mean, error: Mean, weighted by the inverse variances, and its standard error.
        chi_square: $\sum_i (y_i - \bar y)^2 / \sigma_i^2$.
        freedom: Its degrees of freedom, one less than the values.
        chance: Probability that values with these errors scatter as much or more.
        apart: Places of the two values that differ most by the error of their difference.
        errors_apart: That difference, in that error.
    """

    mean: float
    error: float
    chi_square: float
    freedom: int
    chance: float
    apart: tuple[int, int]
    errors_apart: float

    @property
    def ratio(self) -> float:
        """Scatter over what the errors allow: the Birge ratio, the root of chi-square by freedom.

        R. T. Birge: The calculation of errors by the method of least squares, Phys. Rev. 40:207,
        1932.
        """
        return float(np.sqrt(self.chi_square / self.freedom))


def agreement(values: Sequence[float], errors: Sequence[float]) -> Agreement | None:
    """Agreement of values with each other; None for fewer than two.

    Args:
        values: Values of one quantity, from independent results.
        errors: Their standard errors, positive.
    """
    if len(values) < 2:
        return None
    value, error = np.asarray(values, float), np.asarray(errors, float)
    # In units of the smallest error: squares of small errors would leave the range of numbers.
    unit = float(error.min())
    weight = (unit / error) ** 2
    mean = float(np.average(value, weights=weight))
    squares = float(np.sum(((value - mean) / error) ** 2))
    freedom = len(value) - 1
    pairs = {
        (i, j): float(abs(value[i] - value[j]) / np.hypot(error[i], error[j]))
        for i, j in combinations(range(len(value)), 2)
    }
    apart = max(pairs, key=lambda pair: pairs[pair])
    chance = float(chi2.sf(squares, freedom))
    spread = unit / float(np.sqrt(weight.sum()))
    return Agreement(mean, spread, squares, freedom, chance, apart, pairs[apart])
