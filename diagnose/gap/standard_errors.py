"""Standard errors of an effect's numbers, near those found and if the effect is the right one."""

from dataclasses import dataclass

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, gaussian_prior
from diagnose.linear.information import information_on
from diagnose.linear.linear_fit import worth_by_block
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool
from drftjax.effects.catalogue import reported_name


@dataclass(frozen=True)
class StandardErrorSettings:
    """Numbers of the standard errors of an effect's numbers.

    Attributes:
        slow_worth: Independent statements in one bin of a slow part [-].
        fast_worth: Independent statements in one sample of a fast part [-]. A level adds none: it
            is a sum of the bins, each of which counts here.
    """

    slow_worth: float = 1.0
    fast_worth: float = 0.1


DEFAULT_STANDARD_ERROR = StandardErrorSettings()


def standard_errors(
    regressors: Regressors,
    chosen: Hypothesis,
    pool: RunPool,
    settings: StandardErrorSettings = DEFAULT_STANDARD_ERROR,
) -> np.ndarray:
    """Standard error of each coordinate of a hypothesis, shape (free,).

    Of the information that the runs give on them, whatever each run's own log zeta is
    (`diagnose.linear.information`).

    Args:
        regressors: The runs.
        chosen: The hypothesis.
        pool: Threads.
        settings: Independent statements.
    """
    matrices = regressors.gram_matrices_of(chosen.columns, chosen.residual, chosen.log_zeta, pool)
    worth = worth_by_block(matrices.blocks, settings.slow_worth, settings.fast_worth, 0.0)
    width, _ = gaussian_prior(chosen.model, regressors.settings)
    information = information_on(matrices, chosen.fit, width, worth, regressors.settings)
    return np.sqrt(np.diag(np.linalg.inv(information)))


def relative_strength_errors(chosen: Hypothesis, errors: np.ndarray) -> dict[str, float]:
    """By reported name, the relative standard error of the strength that the runs tell best [-].

    Args:
        chosen: The hypothesis.
        errors: Standard error of each coordinate, shape (free,).
    """
    found: dict[str, float] = {}
    for free, at, error in zip(chosen.model.free, chosen.coordinates, errors, strict=True):
        if free.scale is None:
            continue
        name = reported_name(chosen.names[free.index])
        found[name] = min(found.get(name, np.inf), abs(error / at) if at else 1.0)
    return found
