r"""Posterior and evidence of a linear-Gaussian model: the core of empirical-Bayes smoothing.

Data $y = A u + e$ with noise $e \sim N(0, C)$ and prior $u \sim N(c, P^{-1})$ have

$$\Lambda = A^T C^{-1} A + P, \qquad m = \Lambda^{-1} (A^T C^{-1} y + P c),$$

$$-2 \ln p(y) = |y - A m|^2_{C^{-1}} + |m - c|^2_P + \ln|\Lambda| - \ln|P| + \ln|C| + \dots$$

(C. M. Bishop, Pattern Recognition and Machine Learning, 2006, section 3.5). Noise and prior are
chosen by the largest evidence $p(y)$ (D. J. C. MacKay, Bayesian interpolation, Neural Computation
4:415, 1992). The noise model enters only by $[A|y]^T C^{-1} [A|y]$ and $\ln|C|$: any model serves.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class GaussianPosterior:
    """Posterior of the coordinates of one or several independent data sets.

    Attributes:
        mean: m, shape (..., n).
        covariance: $\\Lambda^{-1}$, shape (..., n, n).
        log_evidence: ln p(y) without its constant, summed over the data sets.
        information: $A^T C^{-1} A$, shape (..., n, n).
    """

    mean: Float[np.ndarray, "... n"]
    covariance: Float[np.ndarray, "... n n"]
    log_evidence: float
    information: Float[np.ndarray, "... n n"]


def gaussian_posterior(
    gram: Float[np.ndarray, "... n+1 n+1"],
    prior: Float[np.ndarray, "n n"],
    centre: Float[np.ndarray, " n"] | float = 0.0,
    log_noise: float = 0.0,
    jitter: float = 0.0,
) -> GaussianPosterior:
    r"""Return the posterior of a linear-Gaussian model.

    Args:
        gram: $[A|y]^T C^{-1} [A|y]$ of each data set.
        prior: P, positive definite.
        centre: c.
        log_noise: $\ln|C|$, summed over the data sets.
        jitter: Where positive, $\Lambda$ is scaled to a unit diagonal and this is added to it: for
            columns that differ by many decades in size.
    """
    information, slope, power = gram[..., :-1, :-1], gram[..., :-1, -1], gram[..., -1, -1]
    precision = information + prior
    size = 1 / np.sqrt(np.einsum("...ii->...i", precision)) if jitter else np.ones(slope.shape)
    scale = size[..., :, None] * size[..., None, :]
    scaled = scale * precision + jitter * np.eye(slope.shape[-1])
    inverse = np.linalg.inv(scaled)
    covariance = scale * (inverse + np.swapaxes(inverse, -1, -2)) / 2
    centre = np.broadcast_to(centre, slope.shape)
    mean = _times(covariance, slope + _times(prior, centre))
    away = mean - centre
    misfit = power - 2 * _dot(mean, slope) + _dot(mean, _times(information, mean))
    volume = np.linalg.slogdet(scaled)[1] - 2 * np.log(size).sum(axis=-1)
    volume = volume - np.linalg.slogdet(prior)[1]
    whole = float(np.sum(misfit + _dot(away, _times(prior, away)) + volume))
    return GaussianPosterior(mean, covariance, -0.5 * (whole + log_noise), information)


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (one * other).sum(axis=-1)


def second_difference_precision(count: int) -> Float[np.ndarray, "count count"]:
    r"""Return $D^T D$ with second differences D: the prior of a discrete cubic smoothing spline."""
    bends = np.diff(np.eye(count), 2, axis=0)
    return bends.T @ bends
