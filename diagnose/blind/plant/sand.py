"""The plant's sand: strength that changes with history, slip and place, and sand piled up ahead."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.random_profiles import RandomCurve, flat_curve
from drftjax.common.arrays import as_real
from drftjax.effects.base import (
    AbstractSandLoad,
    AbstractZetaFactor,
    Memory,
    MemorylessZetaFactor,
    StepContext,
    along_x,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Share of its strength that sand keeps whatever is done to it.
LEAST = 0.15


# Turning back [rad] after which a wheel has left the pile ahead of it.
LEFT = 0.1


def number(default: float = 0.0):
    """A number of the plant, an array so that runs of any value share one program."""
    return eqx.field(converter=as_real, default=default)


class PlantLoosening(AbstractZetaFactor):
    """Strength lost with the wheel's turning.

    Attributes:
        loss: Share lost in the end [-].
        decay: Turning that loosens [rad].
        power: Stretches the curve [-].
        form: 0 stretched exponential, 1 power law, 2 linear and then constant.
    """

    loss: Number = number()
    decay: Number = number(2.0)
    power: Number = number(1.0)
    form: Number = number()

    def begin(self) -> Memory:
        return jnp.zeros_like(self.loss)

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return memory + moment.dt * jnp.abs(moment.omega)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        turned = memory / self.decay
        stretched = 1 - jnp.exp(-((turned + 1e-12) ** self.power))
        slow = 1 - (1 + turned) ** -self.power
        lost = jnp.where(self.form < 0.5, stretched, slow)
        lost = jnp.where(self.form > 1.5, jnp.minimum(turned, 1), lost)
        return jnp.maximum(1 - self.loss * lost, LEAST)


class PlantSlipSoftening(MemorylessZetaFactor):
    """Strength lost as a power of slip speed; `loss` is that at 50 mm/s."""

    loss: Number = number()
    power: Number = number(0.5)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        slip = jnp.abs(moment.rim_slip()) + 1e-9
        return jnp.maximum(1 - self.loss * (slip / 0.05) ** self.power, LEAST)


class PlantTerrainVariation(MemorylessZetaFactor):
    """Strength by place, along a curve."""

    excess: Number = number()
    curve: RandomCurve = eqx.field(default_factory=flat_curve)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 + self.excess * self.curve(moment.position[0]), LEAST)


class PlantBulldozing(AbstractSandLoad):
    """Resistance linear in travel up to `length` [m], and `force` [N] from there on.

    A wheel that turns back leaves the pile, bit by bit, and heaps up another on that side.
    """

    force: Number = number()
    length: Number = number(0.3)

    def begin(self, position: Pair) -> Memory:
        nought = jnp.zeros_like(position[0])
        return position[0], nought, nought

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # Where the pile's first sand was met, on which side it lies, how far the wheel turned back.
        began, side, back = memory
        side = jnp.where(side == 0, jnp.sign(moment.omega), side)
        back = jnp.clip(back - side * moment.dt * moment.omega, 0, LEFT)
        left = back >= LEFT
        return (
            jnp.where(left, moment.position[0], began),
            jnp.where(left, -side, side),
            jnp.where(left, 0, back),
        )

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        began, side, back = memory
        travel = jnp.abs(position[0] - began)
        resistance = -self.force * jnp.minimum(travel / self.length, 1)
        parting = jnp.where(side < 0, -resistance, resistance) * (1 - back / LEFT)
        resistance = jnp.where((side < 0) | (back > 0), parting, resistance)
        return along_x(resistance)


SAND = (PlantLoosening, PlantSlipSoftening, PlantTerrainVariation, PlantBulldozing)
