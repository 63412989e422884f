"""Random effect: scatter of values from run to run beyond their standard errors."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar
from scipy.special import chdtri


@dataclass(frozen=True)
class RandomEffect:
    """Mean and between-run variance of some runs' values.

    Attributes:
        mean: Weighted by the inverse variances, between-run variance included.
        variance: From run to run, beyond the errors; zero where they scatter by no more.
        identified: True where errors alone would rarely scatter as much (chi-squared test).
        error: Standard error of the mean, the between-run variance included; infinite for no value.
    """

    mean: float
    variance: float
    identified: bool
    error: float


def paule_mandel(
    values: Float[np.ndarray, " runs"], errors: Float[np.ndarray, " runs"], level: float = 0.95
) -> RandomEffect:
    r"""Return the mean of values and their between-run variance $\tau^2$.

    The solution of $\sum_i (y_i - \bar y)^2 / (\sigma_i^2 + \tau^2) = n - 1$ with the weighted mean
    $\bar y$ (R. C. Paule, J. Mandel: Consensus values and weighting factors, J. Res. NBS 87:377,
    1982).

    Args:
        values: y of each run.
        errors: Their standard errors, positive.
        level: Level of the test for `RandomEffect.identified`: chance passes it in one of twenty
            cases.
    """
    free = len(values) - 1

    def weighted(variance: float) -> tuple[float, float]:
        weight = 1 / (errors**2 + variance)
        mean = float(np.average(values, weights=weight))
        return mean, float(np.sum(weight * (values - mean) ** 2))

    def error_of(variance: float) -> float:
        weight = float(np.sum(1 / (errors**2 + variance)))
        return weight**-0.5 if weight else math.inf

    if free < 1:
        return RandomEffect(float(values.sum()), 0.0, identified=False, error=error_of(0.0))
    mean, squares = weighted(0.0)
    if squares <= free:
        return RandomEffect(mean, 0.0, identified=False, error=error_of(0.0))
    # The plain variance is never smaller.
    most = float(values.var(ddof=1))
    found = root_scalar(lambda each: weighted(each)[1] - free, bracket=(0.0, most))
    identified = bool(squares > chdtri(free, 1 - level))
    variance = float(found.root)
    return RandomEffect(weighted(variance)[0], variance, identified, error_of(variance))
