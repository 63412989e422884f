"""Mechanisms outside the catalogue; the right answer to each of them is "unknown"."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.sand import MIN_ZETA_FACTOR, number
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


# Share of its length over which a catching spring slips off [-].
RELEASE_SHARE = 0.05


class DamagedGrouser(MemorylessZetaFactor):
    """A damaged grouser: strength drops for a short part of every turn.

    Attributes:
        loss: Share lost with the grouser straight at `phase` [-].
        phase: Wheel angle of the greatest loss [rad].
        narrowness: Concentration of the loss (as in a von Mises density) [-].
    """

    loss: Number = number()
    phase: Number = number()
    narrowness: Number = number(10.0)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        near = jnp.exp(self.narrowness * (jnp.cos(moment.angle - self.phase) - 1))
        return jnp.maximum(1 - self.loss * near, MIN_ZETA_FACTOR)


class Healing(AbstractZetaFactor):
    """Strength lost by turning, which recovers with time.

    Attributes:
        loss: Greatest share lost [-].
        turning: Angle that loosens the sand [rad].
        recovery: Time constant of the recovery [s].
    """

    loss: Number = number()
    turning: Number = number(1.0)
    recovery: Number = number(3.0)

    def begin(self) -> Memory:
        return jnp.zeros_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        rate = jnp.abs(moment.omega) / self.turning
        return memory + moment.dt * (rate * (1 - memory) - memory / self.recovery)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 - self.loss * memory, MIN_ZETA_FACTOR)


class Swing(MemorylessZetaFactor):
    """Strength oscillating in time, as with a temperature; 1 at the start.

    Attributes:
        excess: Relative amplitude [-].
        period: Period [s].
        phase: Phase at the start [rad].
    """

    excess: Number = number()
    period: Number = number(12.0)
    phase: Number = number()

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        cycle = 2 * jnp.pi * moment.time / self.period + self.phase
        return jnp.maximum(
            1 + self.excess * (jnp.sin(cycle) - jnp.sin(self.phase)), MIN_ZETA_FACTOR
        )


class Thixotropy(AbstractZetaFactor):
    """Thixotropic sand: slip destroys its structure, time rebuilds it.

    Attributes:
        loss: Share of strength lost without structure [-].
        length: Slip distance that destroys the structure [m].
        recovery: Time constant of the rebuilding [s].
    """

    loss: Number = number()
    length: Number = number(0.05)
    recovery: Number = number(2.0)

    def begin(self) -> Memory:
        return jnp.ones_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        rate = 1 / self.recovery + jnp.abs(moment.rim_slip()) / self.length
        return (memory + moment.dt / self.recovery) / (1 + moment.dt * rate)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 - self.loss * (1 - memory), MIN_ZETA_FACTOR)


class RiseAndFall(MemorylessZetaFactor):
    """Strength that differs between a rising and a sinking wheel.

    Attributes:
        excess: Relative change at full rising speed [-].
        speed: Vertical speed over which the change sets in [m/s].
    """

    excess: Number = number()
    speed: Number = number(2e-3)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(
            1 + self.excess * jnp.tanh(moment.velocity[1] / self.speed), MIN_ZETA_FACTOR
        )


class CriticalSpeed(MemorylessZetaFactor):
    """Strength reduced around one speed of the wheel.

    Attributes:
        loss: Share lost at that speed [-].
        omega: Angular velocity of the greatest loss [rad/s].
        width: Width of the speed range [rad/s].
    """

    loss: Number = number()
    omega: Number = number(1.0)
    width: Number = number(0.3)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        distance = (jnp.abs(moment.omega) - self.omega) / self.width
        return jnp.maximum(1 - self.loss * jnp.exp(-(distance**2)), MIN_ZETA_FACTOR)


class Catch(AbstractLoad):
    """A spring that catches the carriage at one place and slips off after a length.

    A carriage that returns from beyond is held the other way, over the same places.

    Attributes:
        force: Greatest force of the spring [N].
        place: Place of the first contact [m].
        length: Travel in contact [m].
    """

    force: Number = number()
    place: Number = number(0.3)
    length: Number = number(0.15)

    def begin(self, position: Pair) -> Memory:
        return jnp.zeros_like(position[0])

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # One between a reversal beyond the spring and the release before it.
        stretch = self._stretch(moment.position)
        returning = (moment.omega < 0) & (stretch >= 1 + RELEASE_SHARE)
        return jnp.where(stretch <= -RELEASE_SHARE, 0, jnp.where(returning, 1, memory))

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        stretch = self._stretch(position)
        return along_x(jnp.where(memory > 0, self._pull(1 - stretch), -self._pull(stretch)))

    def _stretch(self, position: Pair) -> Number:
        """Travel since the first contact, as a share of the length."""
        return (position[0] - self.place) / self.length

    def _pull(self, stretch: Number) -> Number:
        released = jnp.clip((stretch - 1) / RELEASE_SHARE, 0, 1)
        return self.force * jnp.clip(stretch, 0, 1) * (1 - released)


class SinkageDrag(MemorylessLoad):
    """Drag by speed and sinkage squared, `drag` [N s2/m2] at 20 mm, with half as much lift."""

    drag: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        force = self.drag * velocity[0] * jnp.abs(velocity[0]) * (position[1] / 0.02) ** 2
        return jnp.stack([-force, jnp.abs(force) / 2])


class JammingGuide(MemorylessLoad):
    """Dry friction of the vertical guide that grows with the speed of the carriage.

    Attributes:
        friction: Friction force per carriage speed [N s/m].
        stick: Width of the regularised step at rest [m/s].
    """

    friction: Number = number()
    stick: Number = number(2e-4)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        force = self.friction * jnp.abs(moment.velocity[0])
        return along_z(-force * jnp.tanh(velocity[1] / self.stick))


class TravelLift(MemorylessLoad):
    """Vertical force `lift` [N s/m] times the signed speed of the carriage, as of a skewed rail."""

    lift: Number = number()

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        return along_z(self.lift * velocity[0])


UNLISTED_EFFECTS = (
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
