"""Standard errors of an effect's numbers, near those found and if the effect is the right one."""

from dataclasses import dataclass

import numpy as np

from diagnose.hypotheses.hypothesis import Hypothesis, gaussian_prior
from diagnose.linear.linear_fit import worth_by_block
from diagnose.linear.regressors import Regressors
from diagnose.run_pool import RunPool


@dataclass(frozen=True)
class StandardErrorSettings:
    """Numbers of the standard errors of an effect's numbers.

    Attributes:
        slow_worth: Independent statements in one bin of a slow part [-].
        fast_worth: Independent statements in one sample of a fast part [-].
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
    r"""Standard error of each coordinate of a hypothesis, shape (free,).

    The square root of the diagonal of the inverse of the information on (coordinates, each run's
    log zeta): products of their columns, where block b weighs $w_b/(s_b + \sigma_b^2)$, the
    precision of the coordinates' prior, which bounds the error of a number that the runs do not
    determine, and what the bed says of the zetas.

    Args:
        regressors: The runs.
        chosen: The hypothesis.
        pool: Threads.
        settings: Independent statements.
    """
    matrices = regressors.gram_matrices_of(chosen.columns, chosen.residual, chosen.log_zeta, pool)
    weights = regressors.settings
    floor = weights.model_errors(matrices.blocks) ** 2
    weight = worth_by_block(matrices.blocks, settings.slow_worth, settings.fast_worth)
    weight = weight / (chosen.fit.mean_square + floor)
    gram = np.einsum("b,rbij->rij", weight, matrices.gram[:, :, :-1, :-1])
    width, _ = gaussian_prior(chosen.model, weights)
    count, runs = len(width), len(gram)
    information = np.zeros((count + runs, count + runs))
    information[:count, :count] = np.diag(1 / width**2) + gram[:, 1:, 1:].sum(axis=0)
    information[:count, count:] = gram[:, 1:, 0].T
    information[count:, :count] = gram[:, 1:, 0]
    hold = weights.bed.hold(chosen.fit.zeta_variance, runs - 1)
    own = np.diag(np.maximum(gram[:, 0, 0], 1e-300))
    information[count:, count:] = own + hold * (np.eye(runs) - 1 / runs)
    return np.sqrt(np.diag(np.linalg.inv(information))[:count])


def relative_strength_errors(chosen: Hypothesis, errors: np.ndarray) -> dict[str, float]:
    """By effect, the relative standard error of the strength that its runs tell best [-].

    Args:
        chosen: The hypothesis.
        errors: Standard error of each coordinate, shape (free,).
    """
    found: dict[str, float] = {}
    for free, at, error in zip(chosen.model.free, chosen.coordinates, errors, strict=True):
        if free.scale is None:
            continue
        name = chosen.names[free.index]
        found[name] = min(found.get(name, np.inf), abs(error / at) if at else 1.0)
    return found
