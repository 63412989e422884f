"""Values that scatter from run to run beyond their errors: a random effect."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import root_scalar
from scipy.stats import chi2

# Runs of one value scatter by chance as much as is told in one of twenty cases.
LEVEL = 0.95


@dataclass(frozen=True)
class RandomEffect:
    """Of some runs' values.

    Attributes:
        mean: Each weighed by the inverse of its variance, scatter included.
        variance: From run to run, beyond their errors; zero where they scatter by no more.
        told: Whether errors alone would scatter as much in one of twenty cases only.
    """

    mean: float
    variance: float
    identified: bool


def paule_mandel(values: np.ndarray, errors: np.ndarray) -> RandomEffect:
    """The scatter for which the weighed squares are as many as are free.

    R. C. Paule, J. Mandel: Consensus values and weighting factors, J. Res. NBS 87:377, 1982.

    Args:
        values: Of the runs, shape (runs,).
        errors: Their standard errors, positive; shape (runs,).
    """
    free = len(values) - 1

    def weighed(variance: float) -> tuple[float, float]:
        weight = 1 / (errors**2 + variance)
        mean = float(np.average(values, weights=weight))
        return mean, float(np.sum(weight * (values - mean) ** 2))

    if free < 1:
        return RandomEffect(float(values.sum()), 0.0, identified=False)
    mean, squares = weighed(0.0)
    if squares <= free:
        return RandomEffect(mean, 0.0, identified=False)
    # The plain variance is never less.
    most = float(values.var(ddof=1))
    found = root_scalar(lambda each: weighed(each)[1] - free, bracket=(0.0, most))
    told = bool(squares > chi2.ppf(LEVEL, free))
    return RandomEffect(weighed(found.root)[0], float(found.root), told)
