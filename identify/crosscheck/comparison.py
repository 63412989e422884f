"""Difference, lag and ripple of two zeta series."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.commanded_motion import is_commanded_to_move
from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class ComparisonSettings:
    """Numbers of the comparison of two zeta series.

    Attributes:
        ripple_window: Length of the running mean about which ripple is measured [s].
        sustained_ticks: Ticks in a row that make a slope, or a rest, of more than chance.
        longest_lag: Longest lag that is searched, besides a third of the moving part [s].
        least_correlation: Correlation at the best lag, at least [-].
        least_change: Range of a zeta that counts as following anything: within one step of the
            tuner, as the paper's is, nothing is followed [-].
        least_peak: Correlation by which the best lag must exceed the longest ones: a straight line
            is like itself at any lag [-].
    """

    ripple_window: float = 1.0
    sustained_ticks: int = 10
    longest_lag: float = 5.0
    least_correlation: float = 0.5
    least_change: float = 1e-3
    least_peak: float = 0.02


COMPARISON_SETTINGS = ComparisonSettings()


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
    settings: ComparisonSettings = COMPARISON_SETTINGS,
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
    difference = zeta[moving] - other
    late, correlation = lag(zeta[moving], other, tick, settings)
    spread, frequency = ripple(zeta[moving], tick, settings)
    return Comparison(
        difference=root_mean_square(difference),
        bias=float(difference.mean()),
        lag=late,
        correlation=correlation,
        ripple=spread,
        ripple_frequency=frequency,
        up=float(np.mean(steps > 0)),
        down=float(np.mean(steps < 0)),
        idle=float(np.mean(steps == 0)),
        slew_limit=sustained_part(steps, steps != 0, settings),
        dead_band=sustained_part(steps, steps == 0, settings),
        from_truth=None if truth is None else root_mean_square(zeta[moving] - truth(at)),
    )


def lag(
    late: np.ndarray,
    early: np.ndarray,
    tick: float,
    settings: ComparisonSettings = COMPARISON_SETTINGS,
) -> tuple[float | None, float | None]:
    """Delay of `late` behind `early` [s], and their correlation at that delay [-].

    None where one of them hardly changes, they are unlike, or the longest lags are as good.

    Args:
        late, early: Series on the same ticks [-], shape (ticks,).
        tick: Time between ticks [s].
        settings: Decision numbers.
    """
    if min(np.ptp(late), np.ptp(early)) < settings.least_change:
        return None, None
    most = int(min(settings.longest_lag / tick, len(late) // 3))
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
    peaked = most > 0 and found[best] > max(found[list(ends)]) + settings.least_peak
    if not peaked or found[best] < settings.least_correlation:
        return None, None
    return float(shifts[best] * tick), float(found[best])


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 1e-12 else 0.0


def ripple(
    zeta: np.ndarray, tick: float, settings: ComparisonSettings = COMPARISON_SETTINGS
) -> tuple[float, float | None]:
    """Standard deviation about the running mean [-], and its strongest frequency [Hz]."""
    half = max(1, round(settings.ripple_window / tick / 2))
    sums = np.r_[0.0, np.cumsum(zeta)]
    place = np.arange(len(zeta))
    low, high = np.maximum(place - half, 0), np.minimum(place + half + 1, len(zeta))
    rest = zeta - (sums[high] - sums[low]) / (high - low)
    if rest.std() < 1e-12:
        return 0.0, None
    power = np.abs(np.fft.rfft((rest - rest.mean()) * np.hanning(len(rest)))) ** 2
    return float(rest.std()), float(np.fft.rfftfreq(len(rest), tick)[1 + np.argmax(power[1:])])


def sustained_part(
    steps: np.ndarray,
    counted: np.ndarray,
    settings: ComparisonSettings = COMPARISON_SETTINGS,
) -> float:
    """Share of the ticks that are counted and lie in a long row of equal ones [-]."""
    ends = np.flatnonzero(np.diff(steps)) + 1
    rows = np.split(np.arange(len(steps)), ends)
    long = [row for row in rows if len(row) >= settings.sustained_ticks and counted[row[0]]]
    return sum(len(row) for row in long) / max(len(steps), 1)


def moving_part(
    trial: Trial, time: np.ndarray, settings: ComparisonSettings = COMPARISON_SETTINGS
) -> np.ndarray:
    """Ticks from the first to the last at which wheel or carriage is commanded to move.

    Args:
        trial: The run.
        time: Ticks [s], shape (ticks,).
        settings: Decision numbers.

    Raises:
        InputError: where they are too few to compare.
    """
    at = np.flatnonzero(is_commanded_to_move(trial, time))
    if len(at) < 2 * settings.sustained_ticks:
        raise InputError(
            f"the wheel moves over {len(at)} ticks, too few to compare; give a shorter tick"
        )
    return (np.arange(len(time)) >= at[0]) & (np.arange(len(time)) <= at[-1])


def root_mean_square(values: np.ndarray) -> float:
    """Root mean square, in the unit of the values."""
    return float(np.sqrt(np.mean(np.square(values))))
