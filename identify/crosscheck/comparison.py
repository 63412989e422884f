"""One zeta over ticks beside another: how far apart, how late, how restless."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.commanded_motion import is_commanded_to_move
from drftjax.simulation.trial import Trial

RIPPLE_WINDOW = 1.0


# Ticks in a row that make a slope, or a rest, of more than chance.
SUSTAINED = 10


# A lag is looked for up to so long, and up to a third of the moving part [s].
LONGEST_LAG = 5.0


LEAST_CORRELATION = 0.5


# A zeta that stays within one step of the tuner, as the paper's is, is not followed at all.
LEAST_CHANGE = 1e-3


# By so much the best lag must beat the longest ones: a straight line is like itself at any lag.
LEAST_PEAK = 0.02


Path = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Comparison:
    """One zeta over ticks beside the offline one, over the part in which the wheel moves.

    Attributes:
        difference: Root mean square difference from the offline zeta(t) [-].
        bias: Mean difference [-].
        lag: How long after the offline one, by cross-correlation [s]; None where it cannot be told.
        correlation: At that lag [-].
        ripple: Standard deviation about its own mean over 1 s [-].
        ripple_frequency: The strongest in that ripple [Hz]; None without ripple.
        up, down, idle: Shares of the ticks that raise, lower and leave zeta [-].
        slew_limit: Share of the ticks in rows of ten or more that all step the same way [-].
        dead_band: Share of the ticks in rows of ten or more that all leave zeta alone [-].
        from_truth: Root mean square difference from the true zeta(t) [-], where it is known.
    """

    difference: float
    bias: float
    lag: float | None
    correlation: float | None
    ripple: float
    ripple_frequency: float | None
    up: float
    down: float
    idle: float
    slew_limit: float
    dead_band: float
    from_truth: float | None = None


def compare_series(
    time: np.ndarray,
    zeta: np.ndarray,
    direction: np.ndarray,
    moving: np.ndarray,
    offline: Path,
    truth: Path | None = None,
) -> Comparison:
    """One zeta over ticks beside the offline zeta(t).

    Args:
        time: Ticks, evenly spaced [s].
        zeta: On each of them [-].
        direction: 1, -1 or 0 where it was raised, lowered or left.
        moving: Ticks that are compared.
        offline, truth: zeta(t) [-].
    """
    tick = float(np.median(np.diff(time)))
    at, steps = time[moving], direction[moving]
    other = offline(at)
    apart = zeta[moving] - other
    late, correlation = lag(zeta[moving], other, tick)
    spread, frequency = ripple(zeta[moving], tick)
    return Comparison(
        difference=root_mean_square(apart),
        bias=float(apart.mean()),
        lag=late,
        correlation=correlation,
        ripple=spread,
        ripple_frequency=frequency,
        up=float(np.mean(steps > 0)),
        down=float(np.mean(steps < 0)),
        idle=float(np.mean(steps == 0)),
        slew_limit=sustained_part(steps, steps != 0),
        dead_band=sustained_part(steps, steps == 0),
        from_truth=None if truth is None else root_mean_square(zeta[moving] - truth(at)),
    )


def lag(late: np.ndarray, early: np.ndarray, tick: float) -> tuple[float | None, float | None]:
    """Delay of `late` behind `early` [s], and their correlation at that delay [-].

    None where one of them hardly changes, they are unlike, or the longest lags are as good.
    """
    if min(np.ptp(late), np.ptp(early)) < LEAST_CHANGE:
        return None, None
    most = int(min(LONGEST_LAG / tick, len(late) // 3))
    count = len(late)
    shifts = np.arange(-most, most + 1)
    found = np.array(
        [
            _correlation(late[max(k, 0) : count + min(k, 0)], early[max(-k, 0) : count - max(k, 0)])
            for k in shifts
        ]
    )
    best = int(np.argmax(found)) if len(found) else 0
    ends = (0, len(shifts) - 1)
    peaked = most > 0 and found[best] > max(found[list(ends)]) + LEAST_PEAK
    if not peaked or found[best] < LEAST_CORRELATION:
        return None, None
    return float(shifts[best] * tick), float(found[best])


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 1e-12 else 0.0


def ripple(zeta: np.ndarray, tick: float) -> tuple[float, float | None]:
    """Standard deviation about the mean over 1 s, and its strongest frequency [Hz]."""
    half = max(1, round(RIPPLE_WINDOW / tick / 2))
    sums = np.r_[0.0, np.cumsum(zeta)]
    place = np.arange(len(zeta))
    low, high = np.maximum(place - half, 0), np.minimum(place + half + 1, len(zeta))
    left = zeta - (sums[high] - sums[low]) / (high - low)
    if left.std() < 1e-12:
        return 0.0, None
    power = np.abs(np.fft.rfft((left - left.mean()) * np.hanning(len(left)))) ** 2
    return float(left.std()), float(np.fft.rfftfreq(len(left), tick)[1 + np.argmax(power[1:])])


def sustained_part(steps: np.ndarray, counted: np.ndarray) -> float:
    """Share of the ticks that are counted and lie in a row of at least `SUSTAINED` equal ones."""
    ends = np.flatnonzero(np.diff(steps)) + 1
    rows = np.split(np.arange(len(steps)), ends)
    long = [row for row in rows if len(row) >= SUSTAINED and counted[row[0]]]
    return sum(len(row) for row in long) / max(len(steps), 1)


def moving_part(trial: Trial, time: np.ndarray) -> np.ndarray:
    """From the first to the last time that wheel or carriage is asked to move.

    Args:
        trial: The run.
        time: Ticks [s].

    Raises:
        InputError: where it is so short that nothing can be said of it.
    """
    at = np.flatnonzero(is_commanded_to_move(trial, time))
    if len(at) < 2 * SUSTAINED:
        raise InputError(
            f"the wheel moves over {len(at)} ticks, too few to compare; give a shorter tick"
        )
    return (np.arange(len(time)) >= at[0]) & (np.arange(len(time)) <= at[-1])


def root_mean_square(values: np.ndarray) -> float:
    """In the unit of the values."""
    return float(np.sqrt(np.mean(np.square(values))))
