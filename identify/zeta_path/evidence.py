r"""Smoothness and noise of a linearised zeta(t), by their evidence.

The columns [derivative | data] of each channel are the simulation linearised in log zeta at the
knots. The prior is that of a discrete cubic smoothing spline, the noise of each channel is
first-order autoregressive, and both are chosen by the evidence
(`drftjax.recorded.gaussian_posterior`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from drftjax.recorded.gaussian_posterior import gaussian_posterior, second_difference_precision
from identify.zeta_path.settings import ZETA_PATH_SETTINGS, ZetaPathSettings


@dataclass(frozen=True)
class AR1Noise:
    """First-order autoregressive noise of one channel: standard deviation [m], correlation [-]."""

    spread: float
    correlation: float


@dataclass(frozen=True)
class InstrumentFloor:
    """Limits of one channel's noise.

    Attributes:
        smallest: Smallest standard deviation [m].
        largest_correlation: Largest correlation of a sample with the one before [-].
    """

    smallest: float
    largest_correlation: float

    def white_noise(self, spread: float) -> AR1Noise:
        """Return white noise of this standard deviation [m], or of the smallest."""
        return AR1Noise(max(float(spread), self.smallest), 0.0)


@dataclass(frozen=True, eq=False)
class LaggedProducts:
    r"""Sums of products of one channel's columns [derivative | data], of shape (n, n) each.

    One sum for every interval k that occurs between a sample and the one before (the first sample
    is infinitely late). With $\rho_k = \rho^k$, the inverse covariance of autoregressive noise
    needs no other numbers of the columns:

    $$a^T C^{-1} b = \sum_k (S_k - \rho_k L_k + \rho_k^2 B_k) / (\sigma^2 (1 - \rho_k^2))$$

    Attributes:
        intervals: Every k, shape (kinds,).
        samples: Number of samples with this interval, shape (kinds,).
        current: S, each such sample with itself, shape (kinds, n, n).
        lagged: L, each with the one before, and the transpose, likewise.
        previous: B, the one before with itself, likewise.
    """

    intervals: np.ndarray
    samples: np.ndarray
    current: np.ndarray
    lagged: np.ndarray
    previous: np.ndarray

    @classmethod
    def of(
        cls, columns: Float[np.ndarray, "samples n"], intervals: Float[np.ndarray, " samples"]
    ) -> "LaggedProducts":
        """Sum the products of columns in time.

        Args:
            columns: Derivatives and data at every sample.
            intervals: Usual intervals from the sample before [-], infinite first.
        """
        kinds, kind = np.unique(intervals, return_inverse=True)
        ahead = np.concatenate([np.zeros_like(columns[:1]), columns[:-1]])
        pairs = [(columns[kind == k], ahead[kind == k]) for k in range(len(kinds))]
        lagged = np.stack([here.T @ last for here, last in pairs])
        return cls(
            kinds,
            np.bincount(kind),
            np.stack([here.T @ here for here, _ in pairs]),
            lagged + lagged.transpose(0, 2, 1),
            np.stack([last.T @ last for _, last in pairs]),
        )

    def whitened_gram(self, noise: AR1Noise) -> Float[np.ndarray, "n n"]:
        """Return columns^T C^-1 columns."""
        rho = self.ar1_coefficient(noise)[:, None, None]
        bare = (self.current - rho * self.lagged + rho**2 * self.previous) / (1 - rho**2)
        return bare.sum(axis=0) / noise.spread**2

    def log_determinant(self, noise: AR1Noise) -> float:
        """Return ln |C| of the noise's covariance C."""
        fresh = np.log1p(-(self.ar1_coefficient(noise) ** 2))
        return float((self.samples * (np.log(noise.spread**2) + fresh)).sum())

    def ar1_coefficient(self, noise: AR1Noise) -> Float[np.ndarray, " kinds"]:
        """Return the correlation with the sample before, for each interval; zero for the first."""
        return np.where(np.isfinite(self.intervals), noise.correlation**self.intervals, 0.0)

    def most_probable_noise(
        self, residual: np.ndarray, covariance: np.ndarray, instrument: InstrumentFloor
    ) -> AR1Noise:
        """Return the noise that makes a residual with uncertain coordinates most probable.

        The M step of expectation-maximisation; the correlation comes from neighbours alone.

        Args:
            residual: Coefficients of the residual in the columns, shape (n,).
            covariance: Of the derivative's coordinates, shape (n - 1, n - 1).
            instrument: Limits of the noise.
        """

        def power(sums: np.ndarray) -> float:
            spread = np.sum(sums[:-1, :-1] * covariance)
            return float(residual @ sums @ residual + spread)

        near = self.intervals == 1
        both = power((self.current[near] + self.previous[near]).sum(axis=0))
        rho = power(self.lagged[near].sum(axis=0)) / max(both, 1e-300)
        rho = float(np.clip(rho, 0, instrument.largest_correlation))
        # Rounding can make it negative where the derivative is many times the residual.
        square = max(power(self.whitened_gram(AR1Noise(1.0, rho))), 0.0)
        return AR1Noise(max(float(np.sqrt(square / self.samples.sum())), instrument.smallest), rho)


@dataclass(frozen=True, eq=False)
class PathPosterior:
    """Gaussian posterior of a linearised run at one weight and noise.

    Attributes:
        mean: Of the coordinates: log zeta at the knots, then the start's, shape (n,).
        covariance: Of these, shape (n, n).
        information: Of the data alone, shape (n, n).
        evidence: Log probability of the data.
        weight: Weight of squared second differences.
        noise: Of each channel.
    """

    mean: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    evidence: float
    weight: float
    noise: tuple[AR1Noise, ...]


@dataclass(frozen=True, eq=False)
class LinearizedPath:
    """One run's channels, linearised in zeta(t) and the start.

    Attributes:
        products: Of each channel.
        knots: Number of coordinates that are log zeta; the rest are the start's.
        level: Mean of the prior of log zeta.
        settings: Decision numbers.
    """

    products: Sequence[LaggedProducts]
    knots: int
    level: float
    settings: ZetaPathSettings = ZETA_PATH_SETTINGS

    def posterior(self, weight: float, noise: Sequence[AR1Noise]) -> PathPosterior:
        """Return the posterior at a weight of squared second differences and a noise."""
        pairs = list(zip(self.products, noise, strict=True))
        gram = np.sum([p.whitened_gram(n) for p, n in pairs], axis=0)
        size = len(gram) - 1
        # Second differences do not depend on the level, so the prior needs its mean.
        centre = np.r_[np.full(self.knots, self.level), np.zeros(size - self.knots)]
        found = gaussian_posterior(
            gram,
            smoothness_prior(self.knots, size, weight, self.settings.level_spread),
            centre,
            sum(p.log_determinant(n) for p, n in pairs),
        )
        evidence = found.log_evidence
        return PathPosterior(
            found.mean, found.covariance, found.information, evidence, weight, tuple(noise)
        )

    def maximize_evidence_given_noise(
        self, noise: Sequence[AR1Noise], least: float
    ) -> PathPosterior:
        """Return the posterior at the weight of largest evidence, at least `least`."""
        weights = self.settings.weight_grid
        found = [self.posterior(weight, noise) for weight in weights[least <= weights]]
        return max(found, key=lambda each: each.evidence)

    def maximize_evidence(
        self,
        noise: Sequence[AR1Noise],
        instruments: Sequence[InstrumentFloor],
        kept: float | None = None,
    ) -> PathPosterior:
        """Return the posterior at the weight and noise of largest evidence.

        From the smoothest path to the roughest, the noise at each weight starts from that at its
        neighbour, and once more from the instruments' own: a path may be rough, or its noise
        correlated for long.

        Args:
            noise: To start from.
            instruments: Limits of the noise.
            kept: Weight of the linearisation before, kept unless another is noticeably better.
        """
        found, grid = [], self.settings.weight_grid
        starts = (grid[::-1], noise), (grid, [each.white_noise(0.0) for each in instruments])
        for weights, first in starts:
            now = list(first)
            for weight in weights:
                for _ in range(self.settings.noise_rounds):
                    state = self.posterior(weight, now)
                    residual = np.r_[state.mean, -1.0]
                    now = [
                        p.most_probable_noise(residual, state.covariance, instrument)
                        for p, instrument in zip(self.products, instruments, strict=True)
                    ]
                found.append(self.posterior(weight, now))
        bonus = self.settings.weight_gain
        return max(found, key=lambda each: each.evidence + bonus * (each.weight == kept))


def smoothness_prior(
    knots: int, size: int, weight: float, level_spread: float
) -> Float[np.ndarray, "size size"]:
    """Return the prior's precision of log zeta at the knots and of the start's coordinates.

    Args:
        knots: Number of knots.
        size: Number of all coordinates; those of the start have unit precision.
        weight: Weight of squared second differences.
        level_spread: Standard deviation of the level of log zeta.
    """
    prior = np.eye(size)
    level = np.eye(knots) / (level_spread**2 * knots)
    prior[:knots, :knots] = weight * second_difference_precision(knots) + level
    return prior
