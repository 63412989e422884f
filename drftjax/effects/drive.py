"""Drive effects, between the commanded speeds and those of wheel and carriage."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects.base import (
    AbstractAdjustment,
    AbstractDrive,
    EffectInfo,
    Memory,
    MemorylessDrive,
    Model,
    shape,
    strength,
)
from drftjax.physics.rig import DrivenCarriage

# Regulariser: angle [rad] over which a drive takes up its play.
PLAY_WIDTH = 0.01


Number = Float[Array, ""]


class SpeedGain(MemorylessDrive):
    """The wheel turns at a fixed ratio of the commanded speed."""

    about: ClassVar = EffectInfo(
        "speed_gain",
        "drive",
        "ω = (1 + gain) ω_cmd",
        "the wheel turns at a fixed ratio of the commanded speed",
    )
    gain: Number = strength("-", 0.03, "excess of the wheel's speed over the commanded one")

    def speed(self, omega: Number, angle: Number) -> Number:
        return (1 + self.gain) * omega


class CarriageGain(AbstractAdjustment):
    """A driven carriage runs at a fixed ratio of the commanded speed."""

    about: ClassVar = EffectInfo(
        "carriage_gain",
        "drive",
        "v_x = (1 + gain) v_x,cmd of a driven carriage",
        "a driven carriage runs at a fixed ratio of the speed it is given",
    )
    gain: Number = strength("-", 0.03, "excess of the carriage's speed", least=-0.9)

    def adjust(self, model: Model) -> Model:
        carriage = model.rig.carriage
        if not isinstance(carriage, DrivenCarriage):
            raise InputError("carriage_gain needs a driven carriage; this one is free")
        ratio = (1 + self.gain) * carriage.ratio
        return eqx.tree_at(lambda s: s.rig.carriage.ratio, model, ratio)


class SpeedLag(AbstractDrive):
    """The wheel's speed follows late, as a first-order lag."""

    about: ClassVar = EffectInfo(
        "speed_lag",
        "drive",
        "lag dω/dt = ω_cmd - ω",
        "the wheel's speed follows the command late",
    )
    lag: Number = strength("s", 0.1, "time constant", least=0.0)

    def begin(self, omega: Number, angle: Number) -> Memory:
        return omega

    def turn(
        self, omega: Number, angle: Number, dt: Number, memory: Memory
    ) -> tuple[Number, Memory]:
        # Implicit, so that no lag is the command itself and a little lag already counts.
        followed = omega + self.lag / (self.lag + dt) * (memory - omega)
        return followed, followed


# A gear's ratio need not be whole. From a start an eighth off, three turns are 0.4 of a period off
# at their end: as far as refinement finds the way.
RIPPLE_ORDERS = (
    *np.arange(1.0, 10.0, 0.25).tolist(),
    *np.arange(10.0, 30.0, 0.5).tolist(),
    *range(30, 61),
)


class SpeedRipple(MemorylessDrive):
    """A periodic speed error, locked to the wheel's angle through the gear."""

    about: ClassVar = EffectInfo(
        "speed_ripple",
        "drive",
        "ω = (1 + cosine cos(order φ) + sine sin(order φ)) ω_cmd",
        "a periodic speed error locked to the motor's or gear's angle",
    )
    cosine: Number = strength("-", 0.03, "in-phase share of the speed")
    sine: Number = strength("-", 0.03, "quadrature share of the speed")
    order: Number = shape("-", 8.0, RIPPLE_ORDERS, "periods in a turn of the wheel")

    def speed(self, omega: Number, angle: Number) -> Number:
        phase = self.order * angle
        return (1 + self.cosine * jnp.cos(phase) + self.sine * jnp.sin(phase)) * omega


class SpeedHarmonics(MemorylessDrive):
    """A periodic speed error with its second harmonic, as of a gear's pair of errors or a joint."""

    about: ClassVar = EffectInfo(
        "speed_harmonics",
        "drive",
        "ω = (1 + cosine cos φ' + sine sin φ' + cosine2 cos 2φ' + sine2 sin 2φ') ω_cmd, "
        "φ' = order φ",
        "a periodic speed error that is no pure sine: with its second harmonic",
        form_of="speed_ripple",
    )
    cosine: Number = strength("-", 0.03, "in-phase share of the speed")
    sine: Number = strength("-", 0.03, "quadrature share of the speed")
    cosine2: Number = strength("-", 0.01, "in-phase share of the second harmonic")
    sine2: Number = strength("-", 0.01, "quadrature share of the second harmonic")
    order: Number = shape("-", 8.0, tuple(range(1, 31)), "periods in a turn of the wheel")

    def speed(self, omega: Number, angle: Number) -> Number:
        phase = self.order * angle
        first = self.cosine * jnp.cos(phase) + self.sine * jnp.sin(phase)
        second = self.cosine2 * jnp.cos(2 * phase) + self.sine2 * jnp.sin(2 * phase)
        return (1 + first + second) * omega


class Backlash(AbstractDrive):
    """The wheel starts late by an angle."""

    about: ClassVar = EffectInfo(
        "backlash",
        "drive",
        "ω = 0 until the drive has turned by play either way, then ω_cmd",
        "the wheel starts late by an angle",
    )
    play: Number = strength(
        "rad",
        0.05,
        "angle of the drive before the wheel follows",
        least=0.0,
        far=(0.03, 0.06, 0.1, 0.15, 0.2, 0.27, 0.35),
    )

    def begin(self, omega: Number, angle: Number) -> Memory:
        return jnp.zeros_like(angle)

    def turn(
        self, omega: Number, angle: Number, dt: Number, memory: Memory
    ) -> tuple[Number, Memory]:
        # Play under the width takes a share of it, so that the angle lost is the play itself.
        held = jnp.maximum(self.play, PLAY_WIDTH)
        # Beyond, the drive takes the wheel along; on its way back it crosses the play again.
        end = held + PLAY_WIDTH / 2
        turned = jnp.clip(memory + dt * omega, -end, end)
        way = jnp.clip((jnp.abs(turned) - held) / PLAY_WIDTH + 0.5, 0, 1)
        taken_up = way * way * (3 - 2 * way)
        loose = jnp.minimum(self.play / PLAY_WIDTH, 1) * (1 - taken_up)
        return (1 - loose) * omega, turned


DRIVE = (SpeedGain, CarriageGain, SpeedLag, SpeedRipple, SpeedHarmonics, Backlash)
