"""Residuals divided into bands: by frequency in time, and by order over the wheel's turning.

Bands of a discrete Fourier transform are orthogonal, so the power of all bands adds up to the
residual's. Over the turning every value is weighted by the root of the time that a step of turning
takes, so that its power there is its power in time.
"""

import numpy as np

from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings

STANDING_LABEL = "while standing"
"""Bin of the time at which the wheel stands."""

MIN_SAMPLES = 8
"""A shorter series has no spectrum to speak of."""


def bands(error: np.ndarray, step: float, edges: tuple[float, ...]) -> np.ndarray:
    """Divide an evenly sampled series into bands.

    Args:
        error: The series, shape (samples,).
        step: Between its samples.
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
    """The series at as many evenly spaced times, and their step [s]."""
    if len(time) < 2:
        return error, 1.0
    even = np.linspace(time[0], time[-1], len(time))
    return np.interp(even, time, error), float(even[1] - even[0])


def in_hertz(time: np.ndarray, error: np.ndarray, edges: tuple[float, ...]) -> np.ndarray:
    """Divide a series into frequency bands at its own samples.

    Where samples were lost, these are the bands of the evenly resampled series, interpolated.

    Args:
        time: Of the samples [s], shape (samples,).
        error: The series, shape (samples,).
        edges: Between bands [Hz].

    Returns:
        Shape (bands, samples).
    """
    even, step = resample(time, error)
    at = np.linspace(time[0], time[-1], len(time))
    return np.stack([np.interp(time, at, band) for band in bands(even, step, edges)])


def in_turning(
    time: np.ndarray, turning: np.ndarray, error: np.ndarray, stands: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """Resample a series at even steps of the wheel's turning, with its power in time.

    Args:
        time: Of its samples [s], shape (samples,).
        turning: Angle turned so far [rad], shape (samples,).
        error: The series, shape (samples,).
        stands: Mask of samples at which the wheel stands: left out.

    Returns:
        The series at even steps, the step [turns], and the time of each [s].
    """
    moving = np.flatnonzero(~stands)
    if len(moving) < MIN_SAMPLES:
        return np.zeros(0), 1.0, np.zeros(0)
    turns = turning[moving] / (2 * np.pi)
    turns = turns + 1e-12 * np.arange(len(turns))  # increasing, as an interpolation needs
    even = np.linspace(turns[0], turns[-1], 2 * len(turns))
    step = float(even[1] - even[0])
    when = np.interp(even, turns, time[moving])
    weight = np.sqrt(np.maximum(np.gradient(when), 0))
    return weight * np.interp(even, turns, error[moving]), step, when


def power_by_order(series: np.ndarray, step: float, edges: tuple[float, ...]) -> np.ndarray:
    """Power of a series over the turning in bands of periods a turn, shape (bands, samples)."""
    if not len(series):
        return np.zeros((len(edges) + 1, 0))
    return bands(series, step, edges) ** 2


class SharedLine:
    """Summed power spectrum of many series, to find a line that they share.

    Attributes:
        grid: Middle of each cell, a quarter of a line wide.
        power: Sum over the series in each cell.
    """

    def __init__(
        self,
        first: float,
        last: float,
        width: float,
        settings: LocalizationSettings = DEFAULT_LOCALIZATION,
    ):
        """Empty spectrum.

        Args:
            first, last: Frequencies or orders between which a line is looked for.
            width: Of a line.
            settings: Numbers of a line.
        """
        self.width, self.settings = width, settings
        # From further down, so that the first place has neighbours.
        first -= settings.neighbour_distance * width / 4
        self.grid = np.arange(first, max(last, first) + width / 4, width / 4)
        self.power = np.zeros(len(self.grid))

    def add(self, series: np.ndarray, step: float) -> None:
        """Add an evenly sampled series."""
        if len(series) < MIN_SAMPLES:
            return
        rate = np.fft.rfftfreq(len(series), step)
        power = np.abs(np.fft.rfft(series)) ** 2 / len(series)
        total = np.r_[0, np.cumsum(power)]
        edges = np.r_[self.grid - self.width / 8, self.grid[-1:] + self.width / 8]
        # A cell narrower than the series' own resolution takes its part of the next one's power.
        between = np.interp(edges, np.r_[rate - rate[1] / 2, rate[-1] + rate[1] / 2], total)
        self.power += np.diff(between)

    def strongest(self) -> tuple[float, float]:
        """Place of the strongest line, and its share of the power in its own octave [-].

        Power that only rises or falls with frequency is no line: there must be less on both sides.
        """
        if not self.power.any():
            return 0.0, 0.0
        cells, distance = self.settings.line_cells, self.settings.neighbour_distance
        near = np.convolve(self.power, np.ones(cells), mode="same")
        beside = np.pad(near, distance, mode="edge")
        beside = np.maximum(beside[: -2 * distance], beside[2 * distance :])
        stands_out = np.where(beside < near * self.settings.max_neighbour_ratio, near, 0)
        stands_out[:distance] = 0
        peak = int(np.argmax(stands_out))
        if not stands_out[peak]:
            return 0.0, 0.0
        line = slice(max(peak - cells // 2, 0), peak + cells // 2 + 1)
        at = float(np.average(self.grid[line], weights=self.power[line]))
        octave = (self.grid > at / 1.5) & (self.grid < at * 1.5)
        held = near[peak] / max(float(self.power[octave].sum()), 1e-300)
        # The share of a flat spectrum is taken off.
        flat = min(1.0, cells / max(int(octave.sum()), 1))
        return at, float(max(0.0, (held - flat) / max(1 - flat, 1e-9)))
