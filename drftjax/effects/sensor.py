"""Sensor effects, between the true output and the reading."""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.effects.base import (
    AbstractSensor,
    EffectInfo,
    Memory,
    MemorylessSensor,
    along_z,
    strength,
)

if TYPE_CHECKING:
    from drftjax.physics.state import Output

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Regulariser: angular velocity [rad/s] over which bearing friction turns over; 0.6 deg/s, a tenth
# of the slowest reference run's.
TURN_WIDTH = 0.01


# A delay keeps so many readings, so far apart or a little more [s].
KEPT, KEPT_EVERY = 101, 0.01


def _with_z(output: "Output", z: Number) -> "Output":
    return dataclasses.replace(output, z=z, sinkage=-z)


class SinkageGain(MemorylessSensor):
    """The vertical scale reads a wrong ratio."""

    about: ClassVar = EffectInfo(
        "sinkage_gain",
        "sensor",
        "z read = (1 + gain) z, the static sinkage too",
        "the vertical scale reads a wrong ratio",
    )
    gain: Number = strength("-", 0.03, "excess of the reading", least=-0.9)

    def started(self, position: Pair, weight: Number) -> Pair:
        # The static sinkage was read on this scale, too.
        return position / jnp.stack([jnp.ones_like(self.gain), 1 + self.gain])

    def reading(self, output: "Output") -> "Output":
        return _with_z(output, (1 + self.gain) * output.z)


class SinkageOffset(MemorylessSensor):
    """The zero of the vertical scale is not where the rim touches the surface."""

    about: ClassVar = EffectInfo(
        "sinkage_offset",
        "sensor",
        "z read = z + offset, the static sinkage too",
        "the zero of the vertical scale is off the surface",
        hypothesis=False,
    )
    offset: Number = strength("m", 1e-3, "constant of the reading, upward positive")

    def started(self, position: Pair, weight: Number) -> Pair:
        # The static sinkage was read from this zero, too.
        return position - jnp.stack([jnp.zeros_like(self.offset), self.offset])

    def reading(self, output: "Output") -> "Output":
        return _with_z(output, output.z + self.offset)


class SinkageDrift(MemorylessSensor):
    """The vertical scale drifts with time."""

    about: ClassVar = EffectInfo(
        "sinkage_drift", "sensor", "z read = z + rate t", "the vertical scale drifts with time"
    )
    rate: Number = strength("m/s", 5e-5, "drift of the reading, upward positive")

    def reading(self, output: "Output") -> "Output":
        return _with_z(output, output.z + self.rate * output.time)


class TravelGain(MemorylessSensor):
    """The horizontal scale reads a wrong ratio."""

    about: ClassVar = EffectInfo(
        "travel_gain",
        "sensor",
        "x read = (1 + gain) x, the start too",
        "the horizontal scale reads a wrong ratio",
    )
    gain: Number = strength("-", 0.03, "excess of the reading", least=-0.9)

    def started(self, position: Pair, weight: Number) -> Pair:
        # The place of the start was read on this scale, too.
        return position / jnp.stack([1 + self.gain, jnp.ones_like(self.gain)])

    def reading(self, output: "Output") -> "Output":
        return dataclasses.replace(output, x=(1 + self.gain) * output.x)


class VerticalCompliance(MemorylessSensor):
    """The frame gives under the vertical force, and the height is read beyond it."""

    about: ClassVar = EffectInfo(
        "vertical_compliance",
        "rig",
        "z read = z - compliance fz, the static sinkage under the rig's weight too",
        "the frame gives: the height reads too deep in proportion to the vertical force",
        hypothesis=False,
        channels=("z",),
    )
    compliance: Number = strength("m/N", 1e-5, "depth read too much per force of the sand")

    def started(self, position: Pair, weight: Number) -> Pair:
        # The static sinkage was read with the frame bent by the weight.
        return position + along_z(self.compliance * weight)

    def reading(self, output: "Output") -> "Output":
        return _with_z(output, output.z - self.compliance * output.fz)


class ForceOffset(MemorylessSensor):
    """The force readings hold a constant."""

    about: ClassVar = EffectInfo(
        "force_offset",
        "sensor",
        "fx read = fx + fx_offset, fz read = fz + fz_offset",
        "a force reading is off by a constant",
        channels=("fx", "fz"),
    )
    fx_offset: Number = strength("N", 2.0, "constant of the reading of fx")
    fz_offset: Number = strength("N", 2.0, "constant of the reading of fz")

    def reading(self, output: "Output") -> "Output":
        fx, fz = output.fx + self.fx_offset, output.fz + self.fz_offset
        return dataclasses.replace(output, fx=fx, fz=fz)


class ForceGain(MemorylessSensor):
    """The force readings are off in ratio."""

    about: ClassVar = EffectInfo(
        "force_gain",
        "sensor",
        "fx read = (1 + fx_gain) fx, fz read = (1 + fz_gain) fz",
        "a force reading is off in ratio",
        channels=("fx", "fz"),
    )
    fx_gain: Number = strength("-", 0.03, "excess of the reading of fx", least=-0.9)
    fz_gain: Number = strength("-", 0.03, "excess of the reading of fz", least=-0.9)

    def reading(self, output: "Output") -> "Output":
        fx, fz = (1 + self.fx_gain) * output.fx, (1 + self.fz_gain) * output.fz
        return dataclasses.replace(output, fx=fx, fz=fz)


class ForceCrosstalk(MemorylessSensor):
    """Each force reading holds a share of the other axis, as of a sensor that is tilted."""

    about: ClassVar = EffectInfo(
        "force_crosstalk",
        "sensor",
        "fx read = fx + fz_in_fx fz, fz read = fz + fx_in_fz fx",
        "a force reading is off by a share of the other axis",
        channels=("fx", "fz"),
    )
    fz_in_fx: Number = strength("-", 0.02, "share of fz in the reading of fx")
    fx_in_fz: Number = strength("-", 0.02, "share of fx in the reading of fz")

    def reading(self, output: "Output") -> "Output":
        fx = output.fx + self.fz_in_fx * output.fz
        fz = output.fz + self.fx_in_fz * output.fx
        return dataclasses.replace(output, fx=fx, fz=fz)


class TorqueOffset(MemorylessSensor):
    """The torque reading holds a constant."""

    about: ClassVar = EffectInfo(
        "torque_offset",
        "sensor",
        "torque read = torque + offset",
        "the torque reading is off by a constant",
        channels=("torque",),
    )
    offset: Number = strength("N m", 0.2, "constant of the reading")

    def reading(self, output: "Output") -> "Output":
        return dataclasses.replace(output, torque=output.torque + self.offset)


class TorqueFriction(MemorylessSensor):
    """The torque is read on the motor's side of a bearing, with its friction."""

    about: ClassVar = EffectInfo(
        "torque_friction",
        "sensor",
        "torque read = torque + friction tanh(ω / 0.01 rad/s)",
        "the torque reading holds bearing friction against the turning",
        channels=("torque",),
    )
    friction: Number = strength("N m", 0.2, "friction of the bearing", least=0.0)

    def reading(self, output: "Output") -> "Output":
        against = self.friction * jnp.tanh(output.omega / TURN_WIDTH)
        return dataclasses.replace(output, torque=output.torque + against)


class TorqueGain(MemorylessSensor):
    """The torque reading is off in ratio."""

    about: ClassVar = EffectInfo(
        "torque_gain",
        "sensor",
        "torque read = (1 + gain) torque",
        "the torque reading is off in ratio",
        channels=("torque",),
    )
    gain: Number = strength("-", 0.03, "excess of the reading", least=-0.9)

    def reading(self, output: "Output") -> "Output":
        return dataclasses.replace(output, torque=(1 + self.gain) * output.torque)


CHANNELS = ("x", "z", "fx", "fz", "torque")


# Forces and torque come from one sensor's amplifier, and so from one logger.
LOGGED = ("fx", "fz", "torque")


# Longest delay that the kept readings reach back to [s].
LONGEST_DELAY = (KEPT - 1) * KEPT_EVERY


def _channels(output: "Output", names: tuple[str, ...]) -> Float[Array, " channels"]:
    return jnp.stack([getattr(output, name) for name in names])


def _with_channels(
    output: "Output", values: Float[Array, " channels"], names: tuple[str, ...]
) -> "Output":
    changed = dict(zip(names, values, strict=True))
    if "z" in changed:
        changed["sinkage"] = -changed["z"]
    return dataclasses.replace(output, **changed)


class DelayedSensor(AbstractSensor):
    """A sensor that reads some channels as they were a delay ago, as if at rest before the run."""

    late: ClassVar[tuple[str, ...]]
    delay: eqx.AbstractVar[Number]

    def begin(self, output: "Output") -> Memory:
        """Ages [s] and values of the kept readings."""
        value = _channels(output, self.late)
        ages = KEPT_EVERY * jnp.arange(KEPT, dtype=value.dtype)
        return ages, jnp.repeat(value[None], KEPT, axis=0)

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        # The present first, then what was kept, the latest before the earlier.
        older = memory[0] + dt
        ages = jnp.concatenate([jnp.zeros_like(older[:1]), older])
        values = jnp.concatenate([_channels(output, self.late)[None], memory[1]])
        later = jnp.clip(jnp.sum(ages <= self.delay) - 1, 0, KEPT - 1)
        share = jnp.minimum((self.delay - ages[later]) / (ages[later + 1] - ages[later]), 1)
        value = values[later] + share * (values[later + 1] - values[later])
        # Never closer, or the kept would not reach back far enough; but for the times' rounding.
        due = older[0] > KEPT_EVERY - dt / 100
        kept = jnp.where(due, ages[:-1], older), jnp.where(due, values[:-1], memory[1])
        return _with_channels(output, value, self.late), kept


class ChannelDelay(DelayedSensor):
    """Forces and torque are late against x and z: a second logger, whose clock is behind.

    What was true is kept as by `MeasurementDelay`. A diagnosis looks for it, and for its forms of
    x or z alone, wherever that channel is compared: it costs what `MeasurementDelay` costs.
    """

    about: ClassVar = EffectInfo(
        "channel_delay",
        "sensor",
        "fx, fz, torque read(t) = true(t - delay)",
        "one channel's clock is late against the others: that of forces and torque, by 1 s at most",
        channels=LOGGED,
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0, most=LONGEST_DELAY)

    late: ClassVar[tuple[str, ...]] = LOGGED


class TravelDelay(DelayedSensor):
    """The reading of x is late against the others; otherwise as `ChannelDelay`."""

    about: ClassVar = EffectInfo(
        "travel_delay",
        "sensor",
        "x read(t) = true(t - delay)",
        "one channel's clock is late against the others: that of x, by 1 s at most",
        form_of="channel_delay",
        channels=("x",),
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0, most=LONGEST_DELAY)

    late: ClassVar[tuple[str, ...]] = ("x",)


class SinkageDelay(DelayedSensor):
    """The reading of z is late against the others; otherwise as `ChannelDelay`."""

    about: ClassVar = EffectInfo(
        "sinkage_delay",
        "sensor",
        "z read(t) = true(t - delay)",
        "one channel's clock is late against the others: that of z, by 1 s at most",
        form_of="channel_delay",
        channels=("z",),
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0, most=LONGEST_DELAY)

    late: ClassVar[tuple[str, ...]] = ("z",)


class MeasurementDelay(DelayedSensor):
    """The readings are late, by a second at the most.

    What was true is kept every 10 ms, or at the first step after.
    """

    about: ClassVar = EffectInfo(
        "measurement_delay",
        "sensor",
        "read(t) = true(t - delay)",
        "the readings are late, by 1 s at most",
    )
    delay: Number = strength("s", 0.1, "how late", least=0.0, most=LONGEST_DELAY)

    late: ClassVar[tuple[str, ...]] = CHANNELS


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
        return _channels(output, CHANNELS)

    def read(self, output: "Output", dt: Number, memory: Memory) -> tuple["Output", Memory]:
        value = _channels(output, CHANNELS)
        value = value + self.lag / (self.lag + dt) * (memory - value)
        return _with_channels(output, value, CHANNELS), value


# What reads a force or a torque wrongly before what makes all readings late.
SENSOR = (
    VerticalCompliance,
    SinkageGain,
    SinkageOffset,
    SinkageDrift,
    TravelGain,
    ForceOffset,
    ForceGain,
    ForceCrosstalk,
    TorqueOffset,
    TorqueFriction,
    TorqueGain,
    ChannelDelay,
    TravelDelay,
    SinkageDelay,
    MeasurementDelay,
    MeasurementFilter,
)
