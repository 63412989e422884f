"""An error cut into bands: by frequency in time, and by order in the wheel's turning.

Bands of a discrete Fourier transform are orthogonal, so the power of all bands adds up to the
error's. In the turning every value is weighed by the root of the time that a step of turning
takes, so that its power there is its power in time.
"""

import numpy as np

# Edges between bands [Hz].
HERTZ = (0.1, 0.3, 1.0, 3.0, 10.0)


HERTZ_LABELS = (
    "under 0.1 Hz",
    "0.1 to 0.3 Hz",
    "0.3 to 1 Hz",
    "1 to 3 Hz",
    "3 to 10 Hz",
    "over 10 Hz",
)


# A line is looked for between these and is as wide as the last [Hz].
LINE_FROM, LINE_WIDTH = 0.5, 0.2


# Likewise in periods in a turn of the wheel.
ORDER_FROM, ORDER_TO, ORDER_WIDTH = 0.7, 60.0, 0.5


# A line holds this share of the power in its own octave, and this many times what it would hold
# of it counted the other way: by order for one at fixed hertz, and the reverse.
LINE_SHARE, LINE_GAIN = 0.5, 1.5


# Cells, four in a line's width, that are summed; how far off its neighbourhood is, and how much of
# the line that may hold.
WIDE, AWAY, BESIDE = 5, 6, 0.5


STANDS = "while standing"


def bands(error: np.ndarray, step: float, edges: tuple[float, ...]) -> np.ndarray:
    """An even series cut into bands.

    Args:
        error: Shape (samples,).
        step: Of its samples.
        edges: Between bands, in periods per unit of `step`; ascending.

    Returns:
        Series that add up to it, shape (bands, samples).
    """
    rate = np.fft.rfftfreq(len(error), step)
    spectrum = np.fft.rfft(error)
    place = np.searchsorted(np.asarray(edges), rate, side="right")
    parts = [np.where(place == k, spectrum, 0) for k in range(len(edges) + 1)]
    return np.fft.irfft(parts, len(error), axis=-1)


def resample(time: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, float]:
    """The series at as many even times, and their step [s]; as it is where it is even."""
    if len(time) < 2:
        return error, 1.0
    even = np.linspace(time[0], time[-1], len(time))
    return np.interp(even, time, error), float(even[1] - even[0])


def in_hertz(time: np.ndarray, error: np.ndarray, edges: tuple[float, ...]) -> np.ndarray:
    """A series cut into bands between these edges [Hz], at its samples, shape (bands, samples).

    Where samples were lost, the bands of the series at even times, read at its own.
    """
    even, step = resample(time, error)
    at = np.linspace(time[0], time[-1], len(time))
    return np.stack([np.interp(time, at, band) for band in bands(even, step, edges)])


def power_by_hertz(time: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Power of a series in each band of `HERTZ` at its samples, shape (bands, samples)."""
    return in_hertz(time, error, HERTZ) ** 2


def in_turning(
    time: np.ndarray, turning: np.ndarray, error: np.ndarray, stands: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """A series over the wheel's turning, with its power in time.

    Args:
        time: Of its samples [s].
        turning: Angle turned so far [rad].
        error: The series.
        stands: Where the wheel stands: left out.

    Returns:
        The series at even steps of turning, the step [turns], and the time of each [s].
    """
    moving = np.flatnonzero(~stands)
    if len(moving) < 8:
        return np.zeros(0), 1.0, np.zeros(0)
    turns = turning[moving] / (2 * np.pi)
    turns = turns + 1e-12 * np.arange(len(turns))
    even = np.linspace(turns[0], turns[-1], 2 * len(turns))
    step = float(even[1] - even[0])
    when = np.interp(even, turns, time[moving])
    weight = np.sqrt(np.maximum(np.gradient(when), 0))
    return weight * np.interp(even, turns, error[moving]), step, when


def power_by_order(series: np.ndarray, step: float, edges: tuple[float, ...]) -> np.ndarray:
    """Power of a series over the turning in bands of periods in a turn, shape (bands, samples)."""
    if not len(series):
        return np.zeros((len(edges) + 1, 0))
    return bands(series, step, edges) ** 2


class SharedLine:
    """Power of many series on one grid of frequencies, to find a line that they share.

    Attributes:
        grid: Middle of each cell.
        power: Sum over the series.
    """

    def __init__(self, first: float, last: float, width: float):
        self.width = width
        # From further down, so that what stands beside the first place is seen.
        first -= AWAY * width / 4
        self.grid = np.arange(first, max(last, first) + width / 4, width / 4)
        self.power = np.zeros(len(self.grid))

    def add(self, series: np.ndarray, step: float) -> None:
        """Count a series in."""
        if len(series) < 8:
            return
        rate = np.fft.rfftfreq(len(series), step)
        power = np.abs(np.fft.rfft(series)) ** 2 / len(series)
        total = np.r_[0, np.cumsum(power)]
        edges = np.r_[self.grid - self.width / 8, self.grid[-1:] + self.width / 8]
        # A cell narrower than the series' own resolution takes its part of the next one's power.
        between = np.interp(edges, np.r_[rate - rate[1] / 2, rate[-1] + rate[1] / 2], total)
        self.power += np.diff(between)

    def strongest(self) -> tuple[float, float]:
        """Place of the strongest line, and the share that it holds of its own octave.

        What only rises or falls with frequency is no line: to both sides there must be less.
        """
        if not self.power.any():
            return 0.0, 0.0
        near = np.convolve(self.power, np.ones(WIDE), mode="same")
        beside = np.pad(near, AWAY, mode="edge")
        beside = np.maximum(beside[: -2 * AWAY], beside[2 * AWAY :])
        stands_out = np.where(beside < near * BESIDE, near, 0)
        stands_out[:AWAY] = 0
        peak = int(np.argmax(stands_out))
        if not stands_out[peak]:
            return 0.0, 0.0
        cells = slice(max(peak - WIDE // 2, 0), peak + WIDE // 2 + 1)
        at = float(np.average(self.grid[cells], weights=self.power[cells]))
        octave = (self.grid > at / 1.5) & (self.grid < at * 1.5)
        held = near[peak] / max(float(self.power[octave].sum()), 1e-300)
        # As much as an even spread gives is no line.
        even = min(1.0, WIDE / max(int(octave.sum()), 1))
        return at, float(max(0.0, (held - even) / max(1 - even, 1e-9)))
