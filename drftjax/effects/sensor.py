"""Sensors: what stands between where the wheel is and what is read."""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.stage import About, AbstractSensor, Memory, strength

if TYPE_CHECKING:
    from drftjax.simulator import Output

Number = Float[Array, ""]

# Lags in a row that together stand for a pure delay.
DELAY_STAGES = 8


def _with_z(output: "Output", z: Number) -> "Output":
    return dataclasses.replace(output, z=z, sinkage=-z)


class SinkageGain(AbstractSensor):
    """The vertical scale reads a wrong ratio."""

    about: ClassVar = About(
        "sinkage_gain", "sensor", "z read = (1 + gain) z", "the vertical scale reads a wrong ratio"
    )
    gain: Number = strength("-", 0.03, "excess of the reading")

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return _with_z(output, (1 + self.gain) * output.z), ()


class SinkageDrift(AbstractSensor):
    """The vertical scale drifts with time."""

    about: ClassVar = About(
        "sinkage_drift", "sensor", "z read = z + rate t", "the vertical scale drifts with time"
    )
    rate: Number = strength("m/s", 5e-5, "drift of the reading, upward positive")

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return _with_z(output, output.z + self.rate * output.time), ()


class TravelGain(AbstractSensor):
    """The horizontal scale reads a wrong ratio."""

    about: ClassVar = About(
        "travel_gain",
        "sensor",
        "x read = (1 + gain) x",
        "the horizontal scale reads a wrong ratio",
    )
    gain: Number = strength("-", 0.03, "excess of the reading")

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return dataclasses.replace(output, x=(1 + self.gain) * output.x), ()


def _channels(output: "Output") -> Float[Array, "5"]:
    return jnp.stack([output.x, output.z, output.fx, output.fz, output.torque])


def _with_channels(output: "Output", values: Float[Array, "5"]) -> "Output":
    x, z, fx, fz, torque = values
    return dataclasses.replace(output, x=x, z=z, sinkage=-z, fx=fx, fz=fz, torque=torque)


class MeasurementDelay(AbstractSensor):
    """The readings are late; the delay is drawn as eight equal lags in a row."""

    about: ClassVar = About(
        "measurement_delay", "sensor", "read(t) = true(t - delay)", "the readings are late"
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0)

    def begin(self, output: "Output") -> Memory:
        return jnp.repeat(_channels(output)[None], DELAY_STAGES, axis=0)

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        lag = self.delay / DELAY_STAGES
        share = lag / (lag + dt)
        value, held = _channels(output), []
        for stage in range(DELAY_STAGES):
            value = value + share * (memory[stage] - value)
            held.append(value)
        return _with_channels(output, value), jnp.stack(held)


class MeasurementFilter(AbstractSensor):
    """The readings are low-pass filtered, to first order."""

    about: ClassVar = About(
        "measurement_filter",
        "sensor",
        "lag d(read)/dt = true - read",
        "the readings are low-pass filtered",
    )
    lag: Number = strength("s", 0.1, "time constant", least=0.0)

    def begin(self, output: "Output") -> Memory:
        return _channels(output)

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        value = _channels(output)
        value = value + self.lag / (self.lag + dt) * (memory - value)
        return _with_channels(output, value), value


SENSOR = (SinkageGain, SinkageDrift, TravelGain, MeasurementDelay, MeasurementFilter)
