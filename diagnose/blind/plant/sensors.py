"""Sensors of the plant: position readings with gain, drift, delay, filter and crosstalk."""

import abc
from dataclasses import dataclass, fields, replace

import numpy as np


@dataclass(frozen=True)
class PlantReading:
    """Motion of the wheel and forces of the sand in evenly spaced rows.

    Attributes:
        time: Time from the start of the run, shape (rows,) [s].
        x, z: Position of the axle, shape (rows,) [m].
        omega: Angular velocity of the wheel, shape (rows,) [rad/s].
        fx, fz: Force of the sand on the wheel, shape (rows,) [N].
        torque: Drive torque against the sand, shape (rows,) [N m].
    """

    time: np.ndarray
    x: np.ndarray
    z: np.ndarray
    omega: np.ndarray
    fx: np.ndarray
    fz: np.ndarray
    torque: np.ndarray

    def at(self, time: np.ndarray) -> "PlantReading":
        """Reading interpolated linearly to other times [s], shape (times,), constant beyond."""
        names = [each.name for each in fields(self) if each.name != "time"]
        return PlantReading(
            time=time, **{name: np.interp(time, self.time, getattr(self, name)) for name in names}
        )

    def since(self, time: float) -> "PlantReading":
        """Rows of the reading from a time [s] on."""
        kept = self.time >= time - 1e-9
        return PlantReading(*(getattr(self, each.name)[kept] for each in fields(self)))


class AbstractPlantSensor(abc.ABC):
    """Turns a true motion into what a sensor reads."""

    @abc.abstractmethod
    def read(self, true: PlantReading) -> PlantReading:
        """Sensor reading at the times of the true motion."""


@dataclass(frozen=True)
class PlantSinkageGain(AbstractPlantSensor):
    """Gain error of the sinkage that changes with sinkage.

    Attributes:
        gain: Relative error at zero sinkage [-].
        bend: Relative increase of the error per 20 mm of sinkage [-].
    """

    gain: float
    bend: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z * (1 + self.gain * (1 - self.bend * true.z / 0.02)))


@dataclass(frozen=True)
class PlantSinkageDrift(AbstractPlantSensor):
    """Drift of the sinkage by a power of time.

    Attributes:
        rate: Mean rate over 15 s [m/s].
        power: Exponent [-].
    """

    rate: float
    power: float = 1.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z + self.rate * 15 * (true.time / 15) ** self.power)


@dataclass(frozen=True)
class PlantTravelGain(AbstractPlantSensor):
    """Gain error of the travel that changes with travel.

    Attributes:
        gain: Relative error at the start [-].
        bend: Relative increase of the error per metre [1/m].
    """

    gain: float
    bend: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, x=true.x * (1 + self.gain * (1 + self.bend * true.x)))


@dataclass(frozen=True)
class PlantMeasurementDelay(AbstractPlantSensor):
    """Constant delay of all readings by `delay` [s]."""

    delay: float

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true.at(true.time - self.delay), time=true.time, omega=true.omega)


@dataclass(frozen=True)
class PlantChannelDelay(AbstractPlantSensor):
    """One channel late against the others, as on a second logger with a rate of its own.

    Attributes:
        delay: Delay at the start [s].
        channel: Name of the channel.
        drift: Relative growth of the delay over a minute [-].
    """

    delay: float
    channel: str = "x"
    drift: float = 0.0

    def read(self, true: PlantReading) -> PlantReading:
        late = true.time - self.delay * (1 + self.drift * true.time / 60)
        values = np.interp(late, true.time, getattr(true, self.channel))
        return replace(true, **{self.channel: values})


@dataclass(frozen=True)
class PlantMeasurementFilter(AbstractPlantSensor):
    """Low-pass filter of both readings.

    Attributes:
        lag: Delay of a ramp [s].
        form: "mean" for a moving average, "second order" for two equal first-order filters.
    """

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
    """Vertical reading displaced by `offset` [m s/rad] times the speed of the wheel."""

    offset: float

    def read(self, true: PlantReading) -> PlantReading:
        return replace(true, z=true.z + self.offset * np.abs(true.omega))
