"""The plant's instruments: what is read of where the wheel is."""

import abc
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class PlantReading:
    """Rows evenly spaced in time.

    Attributes:
        time: From the run's start [s].
        x, z: Of the axle [m].
        omega: Of the wheel [rad/s].
    """

    time: np.ndarray
    x: np.ndarray
    z: np.ndarray
    omega: np.ndarray

    def at(self, time: np.ndarray) -> "PlantReading":
        """The reading at other times, linear in between and constant beyond."""
        return PlantReading(
            time, *(np.interp(time, self.time, each) for each in (self.x, self.z, self.omega))
        )


class AbstractPlantSensor(abc.ABC):
    """Turns what is into what is read."""

    @abc.abstractmethod
    def read(self, true: PlantReading) -> PlantReading:
        """What is read at the same times."""


@dataclass(frozen=True)
class PlantSinkageGain(AbstractPlantSensor):
    """A scale that is off by `gain`, by `bend` of it more for 20 mm."""

    gain: float
    bend: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z * (1 + self.gain * (1 - self.bend * true.z / 0.02)))


@dataclass(frozen=True)
class PlantSinkageDrift(AbstractPlantSensor):
    """A drift by a power of time; `rate` [m/s] is its mean over 15 s."""

    rate: float
    power: float = 1.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z + self.rate * 15 * (true.time / 15) ** self.power)


@dataclass(frozen=True)
class PlantTravelGain(AbstractPlantSensor):
    """A scale that is off by `gain`, by `bend` of it more a metre."""

    gain: float
    bend: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, x=true.x * (1 + self.gain * (1 + self.bend * true.x)))


@dataclass(frozen=True)
class PlantMeasurementDelay(AbstractPlantSensor):
    """Readings late by `delay` [s], exactly."""

    delay: float

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true.at(true.time - self.delay), time=true.time, omega=true.omega)


@dataclass(frozen=True)
class PlantMeasurementFilter(AbstractPlantSensor):
    """A low-pass that is late by `lag` [s] on a ramp: a mean, or one of second order."""

    lag: float
    form: str = "second order"

    def read(self, true: PlantReading) -> PlantReading:
        if self.lag <= 0:
            return true
        even = np.linspace(true.time[0], true.time[-1], 4 * (len(true.time) - 1) + 1)
        fine = true.at(even)
        step = float(even[1] - even[0])
        filtered = replace(fine, x=self._pass(fine.x, step), z=self._pass(fine.z, step))
        return replace(filtered.at(true.time), omega=true.omega)

    def _pass(self, values: np.ndarray, step: float) -> np.ndarray:
        if self.form == "mean":
            width = max(1, round(2 * self.lag / step))
            padded = np.concatenate([np.full(width, values[0]), values])
            total = np.cumsum(padded)
            return (total[width:] - total[:-width]) / width
        share = step / (self.lag / 2 + step)
        first = second = float(values[0])
        filtered = np.empty_like(values)
        for index, value in enumerate(values.tolist()):
            first += share * (value - first)
            second += share * (first - second)
            filtered[index] = second
        return filtered


@dataclass(frozen=True)
class DriveCrosstalk(AbstractPlantSensor):
    """The vertical reading moves with the drive's speed, by `offset` [m] a rad/s."""

    offset: float

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z + self.offset * np.abs(true.omega))
