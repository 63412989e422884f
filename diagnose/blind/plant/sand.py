"""Sand of the plant: strength that depends on history, slip and place; bulldozing resistance."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from diagnose.blind.plant.random_profiles import RandomCurve, flat_curve
from drftjax.common.arrays import as_real
from drftjax.effects.base import (
    AbstractSandLoad,
    AbstractZetaFactor,
    Memory,
    MemorylessLoad,
    MemorylessZetaFactor,
    StepContext,
    along_x,
)

Number = Float[Array, ""]


Pair = Float[Array, "2"]


# Least factor on zeta: no mechanism weakens sand beyond it [-].
MIN_ZETA_FACTOR = 0.15


# Sinkage below which a heap grows no smaller [m]: a power of zero has no derivative.
MIN_SINKAGE = 1e-5


# Angle turned back after which the wheel has left the pile ahead of it [rad].
PILE_LOSS_ANGLE = 0.1


def number(default: float = 0.0):
    """Field for a number of an effect: an array, so that runs of any value share one program."""
    return eqx.field(converter=as_real, default=default)


class PlantLoosening(AbstractZetaFactor):
    r"""Strength lost with the angle turned, $1 - l\,g(\phi/\phi_0)$, in one of three forms.

    Attributes:
        loss: Share l lost in the end [-].
        decay: Characteristic angle $\phi_0$ [rad].
        power: Exponent p of the forms [-].
        form: g: 0 for $1 - e^{-u^p}$, 1 for $1 - (1+u)^{-p}$, 2 for $\min(u, 1)$.
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
        angle = memory / self.decay
        exponential = 1 - jnp.exp(-((angle + 1e-12) ** self.power))
        algebraic = 1 - (1 + angle) ** -self.power
        share = jnp.where(self.form < 0.5, exponential, algebraic)
        share = jnp.where(self.form > 1.5, jnp.minimum(angle, 1), share)
        return jnp.maximum(1 - self.loss * share, MIN_ZETA_FACTOR)


class PlantSlipSoftening(MemorylessZetaFactor):
    """Strength lost as a power of slip speed.

    Attributes:
        loss: Share lost at 50 mm/s [-].
        power: Exponent [-].
    """

    loss: Number = number()
    power: Number = number(0.5)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        slip = jnp.abs(moment.rim_slip()) + 1e-9
        return jnp.maximum(1 - self.loss * (slip / 0.05) ** self.power, MIN_ZETA_FACTOR)


class PlantTerrainVariation(MemorylessZetaFactor):
    """Strength that varies along x.

    Attributes:
        excess: Relative change for a unit of the curve [-].
        curve: Curve along x [-].
    """

    excess: Number = number()
    curve: RandomCurve = eqx.field(default_factory=flat_curve)

    def factor(self, moment: StepContext, memory: Memory) -> Number:
        return jnp.maximum(1 + self.excess * self.curve(moment.position[0]), MIN_ZETA_FACTOR)


class PlantBulldozing(AbstractSandLoad):
    """Resistance of the sand pushed ahead: linear in travel up to a length, then constant.

    A wheel that turns back leaves its pile gradually and builds another on the other side.

    Attributes:
        force: Resistance of a full pile [N].
        length: Travel that builds it [m].
    """

    force: Number = number()
    length: Number = number(0.3)

    def begin(self, position: Pair) -> Memory:
        zero = jnp.zeros_like(position[0])
        return position[0], zero, zero

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        # x where the pile begins, side on which it lies, angle turned back since.
        start, side, back = memory
        side = jnp.where(side == 0, jnp.sign(moment.omega), side)
        back = jnp.clip(back - side * moment.dt * moment.omega, 0, PILE_LOSS_ANGLE)
        is_lost = back >= PILE_LOSS_ANGLE
        return (
            jnp.where(is_lost, moment.position[0], start),
            jnp.where(is_lost, -side, side),
            jnp.where(is_lost, 0, back),
        )

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        start, side, back = memory
        travel = jnp.abs(position[0] - start)
        resistance = -self.force * jnp.minimum(travel / self.length, 1)
        fading = jnp.where(side < 0, -resistance, resistance) * (1 - back / PILE_LOSS_ANGLE)
        resistance = jnp.where((side < 0) | (back > 0), fading, resistance)
        return along_x(resistance)


class PlantHeap(MemorylessLoad, AbstractSandLoad):
    r"""Heap ahead of a deep or braked wheel: $-f (H/h)^p (1 + b\,\beta^2)$ along the way.

    $\beta = \max(0, 1 - r\omega / v_x)$ is the braked slip, one at most. A share of the resistance
    bears the wheel.

    Attributes:
        force: Resistance f of a rolling wheel at the reference sinkage [N].
        sinkage: Reference sinkage h [m].
        power: Exponent p [-].
        braking: Growth b of the resistance from a rolling to a locked wheel [-].
        lift: Upward force over the resistance [-].
    """

    force: Number = number()
    sinkage: Number = number(0.02)
    power: Number = number(2.0)
    braking: Number = number(2.0)
    lift: Number = number(0.3)

    def load(self, position: Pair, velocity: Pair, moment: StepContext, memory: Memory) -> Pair:
        speed = velocity[0]
        # A heap builds up over a millimetre a second, so that a standing wheel has none.
        way = speed / jnp.sqrt(speed**2 + 1e-6)
        braked = jnp.clip(1 - moment.radius * moment.omega * speed / (speed**2 + 1e-6), 0, 1)
        depth = jnp.maximum(-position[1], MIN_SINKAGE) / self.sinkage
        force = self.force * depth**self.power * (1 + self.braking * braked**2)
        return jnp.stack([-force * way, self.lift * force * way**2])


SAND_EFFECTS = (
    PlantLoosening,
    PlantSlipSoftening,
    PlantTerrainVariation,
    PlantBulldozing,
    PlantHeap,
)
