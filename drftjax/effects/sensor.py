"""Sensor effects, between the true output and the reading."""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import AbstractSensor, EffectInfo, Memory, strength

if TYPE_CHECKING:
    from drftjax.physics.state import Output

Number = Float[Array, ""]


# A delay keeps so many readings, so far apart or a little more [s].
KEPT, KEPT_EVERY = 101, 0.01


def _with_z(output: "Output", z: Number) -> "Output":
    return dataclasses.replace(output, z=z, sinkage=-z)


class SinkageGain(AbstractSensor):
    """The vertical scale reads a wrong ratio."""

    about: ClassVar = EffectInfo(
        "sinkage_gain",
        "sensor",
        "z read = (1 + gain) z, the static sinkage too",
        "the vertical scale reads a wrong ratio",
    )
    gain: Number = strength("-", 0.03, "excess of the reading", least=-0.9)

    def started(self, position: Float[Array, "2"]) -> Float[Array, "2"]:
        # The static sinkage was read on this scale, too.
        return position / jnp.stack([jnp.ones_like(self.gain), 1 + self.gain])

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return _with_z(output, (1 + self.gain) * output.z), ()


class SinkageOffset(AbstractSensor):
    """The zero of the vertical scale is not where the rim touches the surface."""

    about: ClassVar = EffectInfo(
        "sinkage_offset",
        "sensor",
        "z read = z + offset, the static sinkage too",
        "the zero of the vertical scale is off the surface",
        hypothesis=False,
    )
    offset: Number = strength("m", 1e-3, "constant of the reading, upward positive")

    def started(self, position: Float[Array, "2"]) -> Float[Array, "2"]:
        # The static sinkage was read from this zero, too.
        return position - jnp.stack([jnp.zeros_like(self.offset), self.offset])

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return _with_z(output, output.z + self.offset), ()


class SinkageDrift(AbstractSensor):
    """The vertical scale drifts with time."""

    about: ClassVar = EffectInfo(
        "sinkage_drift", "sensor", "z read = z + rate t", "the vertical scale drifts with time"
    )
    rate: Number = strength("m/s", 5e-5, "drift of the reading, upward positive")

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        return _with_z(output, output.z + self.rate * output.time), ()


class TravelGain(AbstractSensor):
    """The horizontal scale reads a wrong ratio."""

    about: ClassVar = EffectInfo(
        "travel_gain",
        "sensor",
        "x read = (1 + gain) x, the start too",
        "the horizontal scale reads a wrong ratio",
    )
    gain: Number = strength("-", 0.03, "excess of the reading", least=-0.9)

    def started(self, position: Float[Array, "2"]) -> Float[Array, "2"]:
        # The place of the start was read on this scale, too.
        return position / jnp.stack([1 + self.gain, jnp.ones_like(self.gain)])

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
    """The readings are late, by a second at the most.

    What was true is kept every 10 ms, or at the first step after.
    """

    about: ClassVar = EffectInfo(
        "measurement_delay",
        "sensor",
        "read(t) = true(t - delay)",
        "the readings are late, by 1 s at most",
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0, most=(KEPT - 1) * KEPT_EVERY)

    def begin(self, output: "Output") -> Memory:
        value = _channels(output)
        ages = KEPT_EVERY * jnp.arange(KEPT, dtype=value.dtype)
        return ages, jnp.repeat(value[None], KEPT, axis=0)

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        # The present first, then what was kept, the latest before the earlier.
        older = memory[0] + dt
        ages = jnp.concatenate([jnp.zeros_like(older[:1]), older])
        values = jnp.concatenate([_channels(output)[None], memory[1]])
        later = jnp.clip(jnp.sum(ages <= self.delay) - 1, 0, KEPT - 1)
        share = jnp.minimum((self.delay - ages[later]) / (ages[later + 1] - ages[later]), 1)
        value = values[later] + share * (values[later + 1] - values[later])
        # Never closer, or the kept would not reach back far enough; but for the times' rounding.
        due = older[0] > KEPT_EVERY - dt / 100
        kept = jnp.where(due, ages[:-1], older), jnp.where(due, values[:-1], memory[1])
        return _with_channels(output, value), kept


class MeasurementFilter(AbstractSensor):
    """The readings are low-pass filtered, to first order."""

    about: ClassVar = EffectInfo(
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


SENSOR = (SinkageGain, SinkageOffset, SinkageDrift, TravelGain, MeasurementDelay, MeasurementFilter)
