"""Proportional-integral tuner of zeta."""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real, require_between
from drftjax.physics.state import Output, State
from drftjax.physics.terrain import LARGEST_ZETA
from drftjax.tuning.step_tuner import LONGEST_TICK, AbstractTuner, Advance


@dataclass(frozen=True)
class IntegralSettings:
    """Limit of the integral term.

    Attributes:
        max_wait: Longest time without a measurement that counts in the integral [s].
    """

    max_wait: float = 0.1


DEFAULT_INTEGRAL = IntegralSettings()


class ProportionalIntegral(NamedTuple):
    """Memory of the proportional-integral law.

    Attributes:
        error: Error of the last tick that had a measurement, less the dead band [m].
        waited: Time since then [s].
    """

    error: Float[Array, ""]
    waited: Float[Array, ""]


class ProportionalIntegralTuner(AbstractTuner):
    r"""$\Delta\zeta = -(k_p \Delta e + k_i e\, T)$, with T the time since the last measurement.

    The law gives changes and zeta itself is their sum, so neither a bound nor the limit of the
    rate winds anything up: a change beyond them is dropped.

    Attributes:
        tick: Control period [s].
        proportional: Gain k_p [1/m].
        integral: Gain k_i [1/(m s)].
        tolerance: Error that is left alone [m]; beyond it only the excess counts.
        rate: Fastest change of zeta [1/s].
        low, high: Bounds of zeta [-].
        settings: Limit of the integral term; no number of a set-up file.
    """

    tick: Float[Array, ""] = eqx.field(converter=as_real, default=0.01)
    proportional: Float[Array, ""] = eqx.field(converter=as_real, default=150.0)
    integral: Float[Array, ""] = eqx.field(converter=as_real, default=600.0)
    tolerance: Float[Array, ""] = eqx.field(converter=as_real, default=2e-5)
    rate: Float[Array, ""] = eqx.field(converter=as_real, default=1.0)
    low: Float[Array, ""] = eqx.field(converter=as_real, default=0.05)
    high: Float[Array, ""] = eqx.field(converter=as_real, default=10.0)
    settings: IntegralSettings = eqx.field(static=True, default=DEFAULT_INTEGRAL)

    def __check_init__(self):
        require_between("tick", self.tick, 1e-5, LONGEST_TICK, " s")
        require_between("proportional gain", self.proportional, 0.0, 1e6, " 1/m")
        require_between("integral gain", self.integral, 0.0, 1e6, " 1/(m s)")
        require_between("tolerance", self.tolerance, 0.0, 1.0, " m")
        require_between("rate of zeta", self.rate, 0.0, LARGEST_ZETA, " 1/s")
        require_between("lowest zeta", self.low, 0.0, self.high)
        require_between("highest zeta", self.high, 0.0, LARGEST_ZETA)

    def begin(self, state: State, zeta: Float[Array, ""]) -> ProportionalIntegral:
        return ProportionalIntegral(jnp.zeros_like(zeta), jnp.zeros_like(zeta))

    def tune(
        self, memory: ProportionalIntegral, zeta: Float[Array, ""], error: Float[Array, ""]
    ) -> tuple[Float[Array, ""], ProportionalIntegral]:
        fresh = jnp.isfinite(error)
        excess = error - jnp.clip(error, -self.tolerance, self.tolerance)
        waited = jnp.minimum(
            memory.waited + self.tick, jnp.maximum(self.settings.max_wait, self.tick)
        )
        change = self.proportional * (excess - memory.error) + self.integral * excess * waited
        most = self.rate * waited
        tuned = jnp.clip(zeta - jnp.clip(change, -most, most), self.low, self.high)
        after = ProportionalIntegral(
            jnp.where(fresh, excess, memory.error), jnp.where(fresh, 0.0, waited)
        )
        return jnp.where(fresh, tuned, zeta), after

    def follow(
        self,
        memory: ProportionalIntegral,
        advance: Advance,
        state: State,
        zeta: Float[Array, ""],
    ) -> tuple[State, Output, ProportionalIntegral]:
        return *advance(state, zeta), memory
