"""Evidence of a smooth path: a linear-Gaussian problem whose noise and smoothness the data choose.

Columns [derivative | data] of each channel stand for a simulation linearised in log zeta at knots.
The prior is a discrete smoothing spline's; each channel's noise is first-order autoregressive. Both
are chosen by the data's probability, a Gaussian integral in closed form.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# From knots that scatter by a factor e^10 to a straight line for as long as any run.
WEIGHTS = np.logspace(-2, 10, 25)


# Evidence is flat in the noise near its best; more rounds move no error by a percent.
NOISE_ROUNDS = 15


# Of log evidence, less than which is no reason to change a weight.
NOTICEABLE = 0.5


# Standard deviation of the prior of log zeta itself: a factor e^5, so as good as none.
LEVEL_SPREAD = 5.0


@dataclass(frozen=True)
class AR1Noise:
    """First-order autoregressive noise of one channel: standard deviation [m], correlation [-]."""

    spread: float
    correlation: float


@dataclass(frozen=True)
class InstrumentFloor:
    """What one channel's noise may be.

    Attributes:
        floor: Smallest standard deviation [m].
        longest: Largest correlation of a sample with the one before [-].
    """

    smallest: float
    largest_correlation: float

    def white_noise(self, spread: float) -> AR1Noise:
        """White noise of this standard deviation [m], or of the smallest."""
        return AR1Noise(max(float(spread), self.smallest), 0.0)


@dataclass(frozen=True, eq=False)
class LaggedProducts:
    """Sums of products of one channel's columns [derivative | data], of shape (n, n) each.

    Of samples that lie k intervals after the one before, for every k that occurs (the first sample
    of all is an infinite one after). The inverse covariance of autoregressive noise needs no other
    numbers of the columns, with $r = \\rho^k$:

    $$a^T C^{-1} b = \\sum_k (S_k - r L_k + r^2 B_k) / (\\sigma^2 (1 - r^2))$$

    Attributes:
        intervals: Every k, shape (kinds,).
        samples: How many samples lie so, shape (kinds,).
        own: S, of each such sample with itself, shape (kinds, n, n).
        lagged: L, with the one before, either way round, likewise.
        before: B, of the one before with itself, likewise.
    """

    intervals: np.ndarray
    samples: np.ndarray
    current: np.ndarray
    lagged: np.ndarray
    previous: np.ndarray

    @classmethod
    def of(cls, columns: np.ndarray, intervals: np.ndarray) -> "LaggedProducts":
        """Of columns in time.

        Args:
            columns: Shape (samples, n).
            intervals: Usual intervals from the sample before, infinite first, shape (samples,).
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

    def whitened_gram(self, noise: AR1Noise) -> np.ndarray:
        """columns^T C^-1 columns."""
        rho = self.ar1_coefficient(noise)[:, None, None]
        bare = (self.current - rho * self.lagged + rho**2 * self.previous) / (1 - rho**2)
        return bare.sum(axis=0) / noise.spread**2

    def log_determinant(self, noise: AR1Noise) -> float:
        """Logarithm of the determinant of the noise's covariance."""
        fresh = np.log1p(-(self.ar1_coefficient(noise) ** 2))
        return float((self.samples * (np.log(noise.spread**2) + fresh)).sum())

    def ar1_coefficient(self, noise: AR1Noise) -> np.ndarray:
        """What a sample keeps of the one before, by kind: nothing where that is infinitely far."""
        return np.where(np.isfinite(self.intervals), noise.correlation**self.intervals, 0.0)

    def most_probable_noise(
        self, residual: np.ndarray, covariance: np.ndarray, instrument: InstrumentFloor
    ) -> AR1Noise:
        """The noise that makes this residual, known to a covariance, most probable.

        Neighbours alone tell the correlation.

        Args:
            residual: Its coefficients in the columns, shape (n,).
            covariance: Of the derivative's coordinates.
            instrument: What the noise may be.
        """

        def power(sums: np.ndarray) -> float:
            spread = np.sum(sums[:-1, :-1] * covariance)
            return float(residual @ sums @ residual + spread)

        near = self.intervals == 1
        both = power((self.current[near] + self.previous[near]).sum(axis=0))
        rho = np.clip(
            power(self.lagged[near].sum(axis=0)) / max(both, 1e-300),
            0,
            instrument.largest_correlation,
        )
        # Rounding can make nothing of it where the derivative is many times what is left.
        left = max(power(self.whitened_gram(AR1Noise(1.0, float(rho)))), 0.0)
        spread = np.sqrt(left / self.samples.sum())
        return AR1Noise(max(float(spread), instrument.smallest), float(rho))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Mean and covariance of the coordinates, given weight and noise, and their log evidence."""

    mean: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    evidence: float
    weight: float
    noise: tuple[AR1Noise, ...]


def posterior(
    products: Sequence[LaggedProducts],
    knots: int,
    level: float,
    weight: float,
    noise: Sequence[AR1Noise],
) -> Posterior:
    """Gaussian posterior of a linearised run.

    Args:
        products: Of each channel.
        knots: Number of coordinates that are log zeta; the rest are the start's.
        level: Mean of the prior of log zeta.
        weight: Weight of squared second differences.
        noise: Of each channel.
    """
    whitened = np.sum([p.whitened_gram(n) for p, n in zip(products, noise, strict=True)], axis=0)
    information, slope, power = whitened[:-1, :-1], whitened[:-1, -1], whitened[-1, -1]
    prior = smoothness_prior(knots, len(information), weight)
    # Second differences do not see a level, so it is their mean that the prior needs to be told.
    centre = np.r_[np.full(knots, level), np.zeros(len(information) - knots)]
    precision = information + prior
    covariance = np.linalg.inv(precision)
    covariance = (covariance + covariance.T) / 2
    mean = covariance @ (slope + prior @ centre)
    misfit = power - 2 * mean @ slope + mean @ information @ mean
    away = (mean - centre) @ prior @ (mean - centre)
    noise_volume = sum(p.log_determinant(n) for p, n in zip(products, noise, strict=True))
    volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(prior)[1] + noise_volume
    evidence = -0.5 * float(misfit + away + volume)
    return Posterior(mean, covariance, information, evidence, weight, tuple(noise))


def smoothness_prior(knots: int, size: int, weight: float) -> np.ndarray:
    """Precision of a smooth path of log zeta and of the start's coordinates, shape (size, size)."""
    bends = np.diff(np.eye(knots), 2, axis=0)
    prior = np.eye(size)
    prior[:knots, :knots] = weight * bends.T @ bends + np.eye(knots) / (LEVEL_SPREAD**2 * knots)
    return prior


def maximize_evidence_given_noise(
    products: Sequence[LaggedProducts],
    knots: int,
    level: float,
    noise: Sequence[AR1Noise],
    least: float,
) -> Posterior:
    """The posterior at the weight of largest evidence, no less than `least`, for a given noise."""
    weights = WEIGHTS[least <= WEIGHTS]
    found = [posterior(products, knots, level, weight, noise) for weight in weights]
    return max(found, key=lambda each: each.evidence)


def maximize_evidence(
    products: Sequence[LaggedProducts],
    knots: int,
    level: float,
    noise: Sequence[AR1Noise],
    instruments: Sequence[InstrumentFloor],
    kept: float | None = None,
) -> Posterior:
    """The posterior at the weight and noise of largest evidence, over `WEIGHTS`.

    A weight `kept` from the linearisation before gives way only to one that is noticeably more
    probable: between two that are as good, steps would go to and fro for ever.

    From the smoothest path to the roughest, each weight's noise starting from its neighbour's, and
    once more from the instruments' own: a path may be rough, or the noise may last.
    """
    found = []
    for weights, first in (
        (WEIGHTS[::-1], noise),
        (WEIGHTS, [i.white_noise(0.0) for i in instruments]),
    ):
        now = list(first)
        for weight in weights:
            for _ in range(NOISE_ROUNDS):
                state = posterior(products, knots, level, weight, now)
                residual = np.r_[state.mean, -1.0]
                now = [
                    p.most_probable_noise(residual, state.covariance, instrument)
                    for p, instrument in zip(products, instruments, strict=True)
                ]
            found.append(posterior(products, knots, level, weight, now))

    def worth(each: Posterior) -> float:
        return each.evidence + NOTICEABLE * (each.weight == kept)

    return max(found, key=worth)
