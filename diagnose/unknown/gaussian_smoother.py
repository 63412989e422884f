"""A smooth signal in every run, its smoothness and the noise chosen by their evidence.

White noise of each channel, and a prior of level, slope and second differences of the signal at its
knots, beside a log zeta of each run's own (`drftjax.recorded.gaussian_posterior`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from drftjax.recorded.gaussian_posterior import (
    GaussianPosterior,
    gaussian_posterior,
    second_difference_precision,
)


@dataclass(frozen=True)
class SmootherSettings:
    """Decision numbers of the smoother; ranges are decimal logarithms.

    Attributes:
        own_zeta: Standard deviation of each run's own log zeta about its linearisation.
        steps: Steps of the search for the numbers of prior and noise, one after the other.
        max_rounds: Rounds over all numbers at one step, at most.
        small_gain: Log evidence that a round must gain for another at the same step.
        levels: Range of a signal's level over its typical size.
        bends: Range of its second differences from knot to knot over its level.
        noises: Range of the noise over its floor.
        slope_knots: Knots over which a signal's slope makes as much as its level.
        jitter: See `gaussian_posterior`: the sizes of the columns differ by many decades.
    """

    own_zeta: float = 0.05
    steps: tuple[float, ...] = (1.0, 0.5, 0.25, 0.125)
    max_rounds: int = 12
    small_gain: float = 0.01
    levels: tuple[float, float] = (-3.0, 2.0)
    bends: tuple[float, float] = (-4.0, 0.5)
    noises: tuple[float, float] = (0.0, 3.0)
    slope_knots: float = 20.0
    jitter: float = 1e-11


SMOOTHER_SETTINGS = SmootherSettings()


@dataclass(frozen=True, eq=False)
class GramSums:
    """Products of the columns (own log zeta, knots..., data) of every run, by channel.

    Attributes:
        gram: In units of the squared floor, shape (channels, runs, n + 1, n + 1).
        number: Data, shape (channels, runs).
    """

    gram: np.ndarray
    number: np.ndarray

    @classmethod
    def of(
        cls, columns: Sequence[Sequence[np.ndarray]], data: Sequence[Sequence[np.ndarray]]
    ) -> "GramSums":
        """Sum the products of columns (data, n) and data (data,) by channel and run, in floors."""
        whole = [
            [np.c_[a, y] for a, y in zip(*both, strict=True)]
            for both in zip(columns, data, strict=True)
        ]
        return cls(
            np.array([[a.T @ a for a in runs] for runs in whole]),
            np.array([[len(a) for a in runs] for runs in whole]),
        )

    def without_signal(self) -> "GramSums":
        """Return the products of own log zeta and data alone."""
        kept = [0, -1]
        return GramSums(self.gram[..., kept, :][..., kept], self.number)

    def residual_power(self, mean: Float[np.ndarray, "runs n"]) -> Float[np.ndarray, " channels"]:
        """Return the mean square by channel that these coefficients leave, in floors."""
        along = np.c_[mean, np.full(len(mean), -1.0)]
        square = np.einsum("ri,crij,rj->c", along, self.gram, along)
        return np.maximum(square, 0) / np.maximum(self.number.sum(axis=1), 1)


@dataclass(frozen=True, eq=False)
class SmoothedSignal:
    """Signals at the prior and noise of largest evidence.

    Attributes:
        evidence: Logarithm of the data's probability.
        mean: Coefficients of every run (own log zeta, knots...), shape (runs, n).
        covariance: Of them, shape (runs, n, n).
        freedom: Effective number of coefficients that the data determine, own zeta left out.
        residual_power: Mean square of the residual by channel, in floors.
        level: Standard deviation of the signals' level.
        noise: Standard deviation by channel, in floors.
    """

    evidence: float
    mean: np.ndarray
    covariance: np.ndarray
    freedom: float
    residual_power: np.ndarray
    level: float
    noise: np.ndarray


def smooth(
    sums: GramSums, typical: float, settings: SmootherSettings = SMOOTHER_SETTINGS
) -> SmoothedSignal:
    """Return the most probable signals.

    Args:
        sums: Of own log zeta, the knots and the data.
        typical: Size that the signal may well have, in its unit.
        settings: Decision numbers.
    """
    count = sums.gram.shape[-1] - 2
    level_and_slope = _level_and_slope(count, settings.slope_knots)
    bends = second_difference_precision(count)

    def prior(at: np.ndarray) -> np.ndarray:
        level = typical * 10 ** at[0]
        return level_and_slope / level**2 + bends / (level * 10 ** at[1]) ** 2

    noise = _first_noise(sums, settings)
    starts = [np.r_[0.0, bend, np.maximum(noise - drop, 0)] for bend, drop in ((-2, 1), (-0.5, 1))]
    best, found = _maximize(sums, prior, starts, (settings.levels, settings.bends), settings)
    return found(best, float(typical * 10 ** best[0]))


def fit_zeta_only(sums: GramSums, settings: SmootherSettings = SMOOTHER_SETTINGS) -> SmoothedSignal:
    """Return the fit of each run's own log zeta alone, without any signal."""
    only = sums.without_signal()
    starts = [_first_noise(sums, settings)]
    best, found = _maximize(only, lambda _: np.zeros((0, 0)), starts, (), settings)
    return found(best, 0.0)


def _maximize(
    sums: GramSums,
    prior: Callable[[np.ndarray], np.ndarray],
    starts: Sequence[np.ndarray],
    ranges: Sequence[tuple[float, float]],
    settings: SmootherSettings,
) -> tuple[np.ndarray, Callable[[np.ndarray, float], SmoothedSignal]]:
    """Return the logarithms (prior..., noise...) of largest evidence, and the signal at such."""
    low, high = np.array([*ranges, *[settings.noises] * len(sums.gram)]).T

    def posterior(at: np.ndarray, jitter: float) -> GaussianPosterior:
        noise = 10 ** at[len(ranges) :]
        gram = np.einsum("c,crij->rij", noise**-2, sums.gram)
        size = gram.shape[-1] - 1
        precision = np.zeros((size, size))
        precision[0, 0] = settings.own_zeta**-2
        precision[1:, 1:] = prior(at)
        log_noise = float((sums.number.sum(axis=1) * 2 * np.log(noise)).sum())
        return gaussian_posterior(gram, precision, log_noise=log_noise, jitter=jitter)

    def evidence(at: np.ndarray) -> float:
        return posterior(at, settings.jitter).log_evidence

    def found(at: np.ndarray, level: float) -> SmoothedSignal:
        at_best = posterior(at, 0.0)
        mean, covariance = at_best.mean, at_best.covariance
        freedom = np.einsum("rij,rji->ri", covariance, at_best.information)[:, 1:].sum()
        return SmoothedSignal(
            evidence(at),
            mean,
            covariance,
            float(freedom),
            sums.residual_power(mean),
            level,
            10 ** at[len(ranges) :],
        )

    ends = [_coordinate_ascent(evidence, each, low, high, settings) for each in starts]
    return max(ends, key=lambda each: each[1])[0], found


def _first_noise(sums: GramSums, settings: SmootherSettings) -> Float[np.ndarray, " channels"]:
    """Return the logarithm of the noise were nothing fitted."""
    nothing = np.zeros((sums.gram.shape[1], sums.gram.shape[2] - 1))
    return np.clip(
        0.5 * np.log10(np.maximum(sums.residual_power(nothing), 1e-12)), *settings.noises
    )


def _level_and_slope(count: int, slope_knots: float) -> Float[np.ndarray, "count count"]:
    """Return the precision of a signal's mean level and slope for ones of unit size."""
    level = np.full(count, 1 / count)
    along = np.arange(count) - (count - 1) / 2
    slope = slope_knots * along / max(float(along @ along), 1e-9)
    return np.outer(level, level) + np.outer(slope, slope)


def _coordinate_ascent(
    objective: Callable[[np.ndarray], float],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    settings: SmootherSettings,
) -> tuple[np.ndarray, float]:
    """Return the place and value that ever smaller steps along the axes climb to."""
    at = np.clip(start, low, high)
    here = objective(at)
    for step in settings.steps:
        for _ in range(settings.max_rounds):
            before = here
            for axis in range(len(at)):
                for sign in (1, -1):
                    moved = at.copy()
                    moved[axis] = np.clip(at[axis] + sign * step, low[axis], high[axis])
                    if moved[axis] == at[axis]:
                        continue
                    there = objective(moved)
                    if there > here:
                        at, here = moved, there
                        break
            if here - before < settings.small_gain:
                break
    return at, here
