"""A smooth signal for each run behind what was recorded; the data say how smooth, with what noise.

All is Gaussian and linear, so the probability of the data given the few numbers of prior and noise
is known in closed form; those numbers are the ones of largest probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Standard deviation of each run's own log zeta about where it was linearised.
OWN_ZETA = 0.05


# Numbers of prior and noise are searched with these steps of their decimal logarithms.
STEPS = (1.0, 0.5, 0.25, 0.125)


MOST_MOVES = 12


# Level of a signal over its typical size, and its bend from knot to knot over its level.
LEVELS, BENDS = (-3.0, 2.0), (-4.0, 0.5)


# Noise over its floor.
NOISES = (0.0, 3.0)


# Knots over which a signal's slope is as large as its level.
SLOPE_KNOTS = 20.0


@dataclass(frozen=True, eq=False)
class GramSums:
    """Products of the columns (own zeta, knots...) and data of every run, by channel.

    Attributes:
        gram: Columns with columns over the squared floor, shape (channels, runs, n, n).
        slope: Columns with data, shape (channels, runs, n).
        power: Data with data, shape (channels, runs).
        number: Data, shape (channels, runs).
    """

    gram: np.ndarray
    slope: np.ndarray
    power: np.ndarray
    number: np.ndarray

    @classmethod
    def of(
        cls, columns: Sequence[Sequence[np.ndarray]], data: Sequence[Sequence[np.ndarray]]
    ) -> "GramSums":
        """Of columns and data by channel and run, in units of the floor."""
        return cls(
            np.array([[a.T @ a for a in runs] for runs in columns]),
            np.array(
                [
                    [a.T @ y for a, y in zip(c, d, strict=True)]
                    for c, d in zip(columns, data, strict=True)
                ]
            ),
            np.array([[y @ y for y in runs] for runs in data]),
            np.array([[len(y) for y in runs] for runs in data]),
        )


@dataclass(frozen=True, eq=False)
class SmoothedSignal:
    """Signals at the prior and noise of largest probability.

    Attributes:
        evidence: Logarithm of the data's probability.
        mean: Coefficients of every run, shape (runs, n).
        covariance: Of them, shape (runs, n, n).
        freedom: Effective number of coefficients that the data determine, own zeta left out.
        left: Mean square left by channel, in floors.
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


def smooth(sums: GramSums, typical: float) -> SmoothedSignal:
    """The most probable signals.

    Args:
        sums: Of own zeta and the knots.
        typical: Size that the signal may well have.
    """
    count = sums.gram.shape[-1] - 1
    channels = len(sums.gram)
    low = np.r_[LEVELS[0], BENDS[0], np.full(channels, NOISES[0])]
    high = np.r_[LEVELS[1], BENDS[1], np.full(channels, NOISES[1])]
    parts = _prior_parts(count)

    def prior(at: np.ndarray) -> np.ndarray:
        level = typical * 10 ** at[0]
        bend = level * 10 ** at[1]
        return parts[0] / level**2 + parts[1] / bend**2

    def evidence(at: np.ndarray) -> float:
        return _evidence(sums, prior(at), 10 ** at[2:])

    noise = np.clip(0.5 * np.log10(_spread(sums)), *NOISES)
    starts = [np.r_[0.0, bend, np.maximum(noise - drop, 0)] for bend, drop in ((-2, 1), (-0.5, 1))]
    best = max(
        (_coordinate_ascent(evidence, s, low, high) for s in starts), key=lambda each: each[1]
    )[0]
    precision, slope = _posterior(sums, prior(best), 10 ** best[2:])
    covariance = np.linalg.inv(precision)
    mean = np.einsum("rij,rj->ri", covariance, slope)
    gram = np.einsum("c,crij->rij", 10 ** (-2 * best[2:]), sums.gram)
    freedom = np.einsum("rij,rji->ri", covariance, gram)[:, 1:].sum()
    return SmoothedSignal(
        evidence(best),
        mean,
        covariance,
        float(freedom),
        residual_power(sums, mean),
        float(typical * 10 ** best[0]),
        10 ** best[2:],
    )


def fit_zeta_only(sums: GramSums) -> SmoothedSignal:
    """Own zeta alone, without any signal."""
    only = GramSums(sums.gram[..., :1, :1], sums.slope[..., :1], sums.power, sums.number)
    channels = len(sums.gram)
    nothing = np.zeros((0, 0))

    def evidence(at: np.ndarray) -> float:
        return _evidence(only, nothing, 10**at)

    start = np.clip(0.5 * np.log10(_spread(sums)), *NOISES)
    low, high = np.full(channels, NOISES[0]), np.full(channels, NOISES[1])
    best, found = _coordinate_ascent(evidence, start, low, high)
    precision, slope = _posterior(only, nothing, 10**best)
    covariance = np.linalg.inv(precision)
    mean = np.einsum("rij,rj->ri", covariance, slope)
    return SmoothedSignal(found, mean, covariance, 0.0, residual_power(only, mean), 0.0, 10**best)


def residual_power(sums: GramSums, mean: np.ndarray) -> np.ndarray:
    """Mean square that coefficients leave, by channel, in floors."""
    square = (
        sums.power
        - 2 * np.einsum("cri,ri->cr", sums.slope, mean)
        + np.einsum("ri,crij,rj->cr", mean, sums.gram, mean)
    )
    return np.maximum(square.sum(axis=1), 0) / np.maximum(sums.number.sum(axis=1), 1)


def _spread(sums: GramSums) -> np.ndarray:
    power = sums.power.sum(axis=1) / np.maximum(sums.number.sum(axis=1), 1)
    return np.maximum(power, 1e-12)


def _prior_parts(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Precision of level and slope, and of the bends, for ones of unit size."""
    bends = np.diff(np.eye(count), 2, axis=0)
    level = np.full(count, 1 / count)
    along = np.arange(count) - (count - 1) / 2
    slope = SLOPE_KNOTS * along / max(float(along @ along), 1e-9)
    return np.outer(level, level) + np.outer(slope, slope), bends.T @ bends


def _posterior(
    sums: GramSums, prior: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    precision = np.einsum("c,crij->rij", noise**-2, sums.gram)
    precision[:, 0, 0] += OWN_ZETA**-2
    precision[:, 1:, 1:] += prior
    return precision, np.einsum("c,cri->ri", noise**-2, sums.slope)


def _evidence(sums: GramSums, prior: np.ndarray, noise: np.ndarray) -> float:
    precision, slope = _posterior(sums, prior, noise)
    # In units of its own diagonal: the columns' sizes differ by many decades.
    size = 1 / np.sqrt(np.einsum("rii->ri", precision))
    scaled = precision * size[:, :, None] * size[:, None, :]
    scaled += 1e-11 * np.eye(len(size[0]))
    root = np.linalg.cholesky(scaled)
    half = np.linalg.solve(root, (slope * size)[..., None])[..., 0]
    volume = 2 * np.log(np.einsum("rii->ri", root)).sum() - 2 * np.log(size).sum()
    before = len(slope) * (np.linalg.slogdet(prior)[1] - 2 * np.log(OWN_ZETA))
    misfit = float((noise**-2 * sums.power.sum(axis=1)).sum()) - float((half**2).sum())
    spread = float((sums.number.sum(axis=1) * 2 * np.log(noise)).sum())
    return -0.5 * (misfit + volume - before + spread)


def _coordinate_ascent(worth, start: np.ndarray, low: np.ndarray, high: np.ndarray):
    """Up along the axes, with ever smaller steps."""
    at = np.clip(start, low, high)
    here = worth(at)
    for step in STEPS:
        for _ in range(MOST_MOVES):
            before = here
            for axis in range(len(at)):
                for sign in (1, -1):
                    moved = at.copy()
                    moved[axis] = np.clip(at[axis] + sign * step, low[axis], high[axis])
                    if moved[axis] == at[axis]:
                        continue
                    there = worth(moved)
                    if there > here:
                        at, here = moved, there
                        break
            if here - before < 0.01:
                break
    return at, here
