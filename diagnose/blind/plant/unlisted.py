"""Mechanisms that no catalogue lists: the right answer to each is that it is unknown."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.sand import LEAST, number
from drftjax.effects.base import (
    AbstractLoad,
    AbstractZetaFactor,
    Memory,
    MemorylessLoad,
    MemorylessZetaFactor,
    StepContext,
    along_x,
    along_z,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Share of its length over which a spring slips off.
SLIP = 0.05


class DamagedGrouser(MemorylessZetaFactor):
    """One grouser bears less: strength drops for a short part of every turn."""

    loss: Number = number()
    phase: Number = number()
    narrowness: Number = number(10.0)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        near = jnp.exp(self.narrowness * (jnp.cos(moment.angle - self.phase) - 1))
        return jnp.maximum(1 - self.loss * near, LEAST)


class Healing(AbstractZetaFactor):
    """Turning loosens, time heals: what counts is the turning of the last few seconds."""

    loss: Number = number()
    turning: Number = number(1.0)
    recovery: Number = number(3.0)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        rate = jnp.abs(moment.omega) / self.turning
        return memory + moment.dt * (rate * (1 - memory) - memory / self.recovery)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 - self.loss * memory, LEAST)


class Swing(MemorylessZetaFactor):
    """Strength swings with time alone, as with a temperature."""

    excess: Number = number()
    period: Number = number(12.0)
    phase: Number = number()

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        turn = 2 * jnp.pi * moment.time / self.period + self.phase
        return jnp.maximum(1 + self.excess * (jnp.sin(turn) - jnp.sin(self.phase)), LEAST)


class Thixotropy(AbstractZetaFactor):
    """Structure that slip destroys and time builds up again."""

    loss: Number = number()
    length: Number = number(0.05)
    recovery: Number = number(2.0)

    def begin(self) -> Memory:
        return jnp.ones_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        ruin = jnp.abs(moment.rim_slip()) / self.length
        rate = 1 / self.recovery + ruin
        return (memory + moment.dt / self.recovery) / (1 + moment.dt * rate)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 - self.loss * (1 - memory), LEAST)


class RiseAndFall(MemorylessZetaFactor):
    """Sand that bears otherwise while the wheel rises than while it sinks."""

    excess: Number = number()
    speed: Number = number(2e-3)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 + self.excess * jnp.tanh(moment.velocity[1] / self.speed), LEAST)


class CriticalSpeed(MemorylessZetaFactor):
    """Sand that is weak about one speed of the wheel only."""

    loss: Number = number()
    omega: Number = number(1.0)
    width: Number = number(0.3)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        away = (jnp.abs(moment.omega) - self.omega) / self.width
        return jnp.maximum(1 - self.loss * jnp.exp(-(away**2)), LEAST)


class Catch(AbstractLoad):
    """The carriage tightens a spring at one place, and slips off it `length` [m] on.

    One that comes back from beyond tightens it the other way, over the same places.
    """

    force: Number = number()
    place: Number = number(0.3)
    length: Number = number(0.15)

    def begin(self, position: Pair) -> Memory:
        return jnp.zeros_like(position[0])

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # One from where a wheel turns back beyond the spring until it is free before it.
        way = self._way(moment.position)
        back = jnp.where((moment.omega < 0) & (way >= 1 + SLIP), 1, memory)
        return jnp.where(way <= -SLIP, 0, back)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        way = self._way(position)
        return along_x(jnp.where(memory > 0, self._pull(1 - way), -self._pull(way)))

    def _way(self, position: Pair) -> Number:
        return (position[0] - self.place) / self.length

    def _pull(self, way: Number) -> Number:
        released = jnp.clip((way - 1) / SLIP, 0, 1)
        return self.force * jnp.clip(way, 0, 1) * (1 - released)


class SinkageDrag(MemorylessLoad):
    """A drag by speed squared and sinkage squared, that lifts half as much."""

    drag: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        force = self.drag * velocity[0] * jnp.abs(velocity[0]) * (position[1] / 0.02) ** 2
        return jnp.stack([-force, jnp.abs(force) / 2])


class JammingGuide(MemorylessLoad):
    """Dry friction of the vertical guide that grows with the carriage's speed."""

    friction: Number = number()
    stick: Number = number(2e-4)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        pressed = self.friction * jnp.abs(moment.velocity[0])
        return along_z(-pressed * jnp.tanh(velocity[1] / self.stick))


class TravelLift(MemorylessLoad):
    """A vertical force with the carriage's speed, as of a rail out of true: it turns with it."""

    lift: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(self.lift * velocity[0])


STRANGERS = (
    DamagedGrouser,
    Healing,
    Swing,
    Thixotropy,
    RiseAndFall,
    CriticalSpeed,
    Catch,
    SinkageDrag,
    JammingGuide,
    TravelLift,
)
