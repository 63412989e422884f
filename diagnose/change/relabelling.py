"""Test of a change by exact relabelling: no model of noise, sand or effect.

Where nothing changed, the runs of a condition could as well have borne the labels `before` and
`now` in any other order. The statistic is computed for every order within the conditions; p is the
share in which it is as large as observed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import comb, prod

import numpy as np

from diagnose.change.differences.gram import Differences, SharedClock

# Relative difference below which two values of the statistic are the same: roundings.
ROUNDING = 1e-9


@dataclass(frozen=True)
class RelabellingSettings:
    """Numbers of the test.

    Attributes:
        parts: A run is described by the mean of each channel over so many equal parts of its time.
        max_orders: With more orders than this, so many are drawn.
        seed: Of the draw.
    """

    parts: int = 4
    max_orders: int = 4096
    seed: int = 0


DEFAULT_RELABELLING = RelabellingSettings()


@dataclass(frozen=True)
class RelabellingTest:
    """Result of the test.

    Attributes:
        p: Share of the orders in which the runs differ as much as observed [-].
        orders: Number of orders compared.
        least_p: Smallest p that so few runs can give [-].
    """

    p: float
    orders: int
    least_p: float


def relabelling_test(
    differences: Differences,
    residual: Sequence[np.ndarray],
    settings: RelabellingSettings = DEFAULT_RELABELLING,
) -> RelabellingTest:
    r"""Compare before and now with every other order of the labels within conditions.

    With $f_c$ the mean now less the mean before of a feature in condition c, and $v_c$ the mean
    square of all runs' deviations from the condition's mean, the statistic is

    $$T = \sum_f \frac{\big(\sum_c f_c\big)^2}{\sum_c v_c},$$

    so that what differs in one direction everywhere counts. $v_c$ does not depend on the labels.

    Args:
        differences: The runs.
        residual: By run, simulated minus recorded at one zeta for each condition [m, N, N m], shape
            (channels, samples); what the starts differ by is taken off with it.
        settings: Numbers of the test.
    """
    features = [
        _features(differences, clock, residual, settings.parts) for clock in differences.clocks
    ]
    scale = sum(((each - each.mean(axis=0)) ** 2).mean(axis=0) for each in features)
    scale = np.where(scale > 0, scale, np.inf)
    sides = [len(clock.condition.now) for clock in differences.clocks]

    def statistic(order: Sequence[Sequence[int]]) -> float:
        total = np.zeros_like(scale)
        for each, chosen in zip(features, order, strict=True):
            is_now = np.isin(np.arange(len(each)), chosen)
            total += each[is_now].mean(axis=0) - each[~is_now].mean(axis=0)
        return float((total**2 / scale).sum())

    observed_order = [
        tuple(range(len(f) - n, len(f))) for f, n in zip(features, sides, strict=True)
    ]
    observed = statistic(observed_order)
    sizes = [comb(len(each), n) for each, n in zip(features, sides, strict=True)]
    values = np.array([statistic(each) for each in _orders(features, sides, sizes, settings)])
    as_large = values >= observed * (1 - ROUNDING)
    if prod(sizes) > settings.max_orders:
        count = len(values) + 1
        return RelabellingTest((as_large.sum() + 1) / count, count, 1 / count)
    largest = values >= values.max() * (1 - ROUNDING)
    return RelabellingTest(float(as_large.mean()), len(values), float(largest.mean()))


def _orders(
    features: Sequence[np.ndarray],
    sides: Sequence[int],
    sizes: Sequence[int],
    settings: RelabellingSettings,
) -> Iterator[Sequence[Sequence[int]]]:
    """Runs of each condition that are labelled `now`, in every order, or in some that are drawn."""
    if prod(sizes) <= settings.max_orders:
        yield from product(
            *(combinations(range(len(f)), n) for f, n in zip(features, sides, strict=True))
        )
        return
    draw = np.random.default_rng(settings.seed)
    for _ in range(settings.max_orders - 1):
        yield [draw.permutation(len(f))[:n].tolist() for f, n in zip(features, sides, strict=True)]


def _features(
    differences: Differences, clock: SharedClock, residual: Sequence[np.ndarray], parts: int
) -> np.ndarray:
    """Means over parts of the time of each channel, shape (runs of the condition, features)."""
    dataset, members = differences.dataset, clock.condition.runs
    found = []
    for run in members:
        at = clock.at(dataset.time(run), residual[run].T)
        found.append(np.concatenate([each.mean(axis=0) for each in np.array_split(at, parts)]))
    return np.nan_to_num(np.array(found))
