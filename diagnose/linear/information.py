r"""Information that runs give on an effect's numbers, from products of their columns.

Block b of the residuals weighs $w_b/(s_b + \sigma_b^2)$, with the mean square $s_b$ that is left in
it, a model's own error $\sigma_b$ and the independent statements $w_b$ in one of its values. To
the products of (coordinates, each run's log zeta) comes the precision of the coordinates' prior,
which bounds the error of a number that the runs do not determine, and what the bed says of zetas.
"""

import numpy as np

from diagnose.linear.linear_fit import GramMatrices, LinearFit, LinearFitSettings


def information_on(
    matrices: GramMatrices,
    fit: LinearFit,
    prior: np.ndarray,
    worth: np.ndarray,
    settings: LinearFitSettings,
) -> np.ndarray:
    """Information on the coordinates, whatever each run's own log zeta is, shape (free, free).

    Args:
        matrices: Gram matrices of (own log zeta, coordinates..., residual).
        fit: What is left, and the variance of log zeta over the runs.
        prior: Width of the Gaussian prior on each coordinate, shape (free,).
        worth: Independent statements in one value of each block [-], shape (blocks,).
        settings: Of fits: a model's own errors and the bed.
    """
    floor = settings.model_errors(matrices.blocks) ** 2
    weight = worth / (fit.mean_square + floor)
    gram = np.einsum("b,rbij->rij", weight, matrices.gram[:, :, :-1, :-1])
    runs = len(gram)
    hold = settings.bed.hold(fit.zeta_variance, runs - 1)
    own = np.diag(np.maximum(gram[:, 0, 0], 1e-300)) + hold * (np.eye(runs) - 1 / runs)
    cross = gram[:, 0, 1:]
    coordinates = np.diag(1 / prior**2) + gram[:, 1:, 1:].sum(axis=0)
    return coordinates - cross.T @ np.linalg.solve(own, cross)
