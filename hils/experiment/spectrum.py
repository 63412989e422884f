"""Amplitude spectra of a short record, and the orders of rotation in it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError

# The spectrum is drawn so much finer than 1 / duration, so that a peak can be read off.
OVERSAMPLING = 8


# A Hann window's main lobe reaches so many 1 / duration from its peak.
LOBE_WIDTH = 2.0


# Least amplitude of which a logarithm is taken.
MIN_AMPLITUDE = 1e-300


class SpectralLine(NamedTuple):
    """One peak: its frequency [Hz], and the amplitude of the sinusoid that would make it."""

    frequency: float
    amplitude: float


class Spectrum(NamedTuple):
    """Amplitude by frequency.

    Attributes:
        frequency: From 0 to half the sampling rate [Hz].
        amplitude: Of the sinusoid that would show so, in the record's own unit.
        resolution: Two lines closer than this run together [Hz].
    """

    frequency: NDArray[np.floating]
    amplitude: NDArray[np.floating]
    resolution: float

    def at(self, frequency: float) -> float:
        """The amplitude at a frequency [Hz]."""
        return float(np.interp(frequency, self.frequency, self.amplitude))

    def lines(self, count: int = 3) -> list[SpectralLine]:
        """The largest peaks, largest first, each at least a resolution from those before it."""
        inner = self.amplitude[1:-1]
        peak = (inner > self.amplitude[:-2]) & (inner >= self.amplitude[2:])
        found: list[SpectralLine] = []
        for place in sorted(np.flatnonzero(peak) + 1, key=lambda each: -self.amplitude[each]):
            line = self._line(int(place))
            near = [abs(line.frequency - each.frequency) < self.resolution for each in found]
            if line.frequency > self.resolution and not any(near):
                found.append(line)
            if len(found) == count:
                break
        return found

    def _line(self, place: int) -> SpectralLine:
        """The top of the parabola through a peak and its neighbours, in decibels."""
        low, top, high = np.log(np.maximum(self.amplitude[place - 1 : place + 2], MIN_AMPLITUDE))
        bend = low - 2 * top + high
        shift = 0.0 if bend >= 0 else 0.5 * (low - high) / bend
        step = self.frequency[1]
        height = top - 0.25 * (low - high) * shift
        return SpectralLine(float(self.frequency[place] + shift * step), float(np.exp(height)))


def spectrum(values: NDArray[np.floating], interval: float) -> Spectrum:
    """Amplitude spectrum of an even record, its slow change (a parabola) taken off, Hann window.

    Args:
        values: The record, shape (samples,).
        interval: From one sample to the next [s].

    Raises:
        InputError: where it has fewer than 16 samples, or one that is no number.
    """
    values = np.asarray(values, float)
    if len(values) < 16 or not np.isfinite(values).all():
        raise InputError(f"a spectrum takes 16 finite samples or more, not {len(values)} as given")
    time = np.linspace(-1.0, 1.0, len(values))
    slow = np.polynomial.Polynomial.fit(time, values, 2)
    window = np.hanning(len(values))
    length = OVERSAMPLING * len(values)
    amplitude = 2 * np.abs(np.fft.rfft((values - slow(time)) * window, length)) / window.sum()
    return Spectrum(
        np.fft.rfftfreq(length, interval), amplitude, LOBE_WIDTH / (len(values) * interval)
    )


def order(frequency: float, omega: float) -> float:
    """Cycles in one turn [-] of what repeats at a frequency [Hz] while a wheel turns [rad/s]."""
    return 2 * np.pi * frequency / abs(omega)
