r"""Kalman filter for zeta of the real sand, by the simulator's own derivative.

It sees one number, the error $e = H_{real} - H_{sim}$, and moves one, zeta. Less sinkage takes
stronger sand, so zeta moves against the error. `docs/theory/hils-tuners.md` compares the tuners.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real, require_between
from drftjax.physics.state import Output, State
from drftjax.physics.terrain import LARGEST_ZETA
from drftjax.tuning.step_tuner import LONGEST_TICK, AbstractTuner, Advance


@dataclass(frozen=True)
class KalmanSettings:
    """Limits within which the simulator's derivatives are trusted.

    Attributes:
        min_retention: Share of an error in sinkage that a tick leaves, at least [-]: a tick that
            forgets more is chatter.
        min_sinkage_rate: Rate at which a zeta higher by one moves the sinkage [m/s], under which
            zeta counts as having no effect on it: a hundredth of that of a wheel at 30 deg/s.
    """

    min_retention: float = 0.5
    min_sinkage_rate: float = 1e-3


DEFAULT_KALMAN = KalmanSettings()


class Belief(NamedTuple):
    """Memory of the Kalman filter.

    Attributes:
        gap: Estimate of real minus simulated sinkage [m].
        strength: Estimate of the real sand's zeta [-].
        covariance: Of the two estimates, shape (2, 2).
        kept: Share of a gap that the last tick left [-].
        gained: Sinkage that the last tick gave for a zeta higher by one [m].
        slow: Direction of the whole state that a lasting change of the sinkage takes, 1 in the
            sinkage [m/m], shape (state,).
        fast: Derivative of the rest of the state by zeta, the sinkage apart [m, m/s, ...], shape
            (state,).
    """

    gap: Float[Array, ""]
    strength: Float[Array, ""]
    covariance: Float[Array, "2 2"]
    kept: Float[Array, ""]
    gained: Float[Array, ""]
    slow: Float[Array, " state"]
    fast: Float[Array, " state"]


class KalmanTuner(AbstractTuner):
    r"""A Kalman filter for the real sand's zeta, by the simulator's own derivative.

    Real and simulated sinkage differ by a gap d, which a tick carries on by

    $$d^+ = a\, d + b\,(\zeta_{real} - \zeta_{sim}),\qquad a = \partial H^+/\partial H,\quad
      b = \partial H^+/\partial\zeta$$

    and zeta_real walks at random. a and b come from `jax.jvp` through the tick: two directions of
    the state are carried along from tick to tick, that of a lasting change of the sinkage and that
    of a lasting change of zeta, which is the recursion of the sensitivity dH/dzeta taken apart.
    zeta is then the estimate for the sand, and as much more as takes the gap to the share
    $e^{-T/\tau}$ by the next tick: a Gauss-Newton step, damped where zeta has no effect on the
    sinkage. A wheel at rest has a = 1, b = 0: nothing is learnt there and zeta stays.

    Attributes:
        tick: Control period T [s].
        drift: Random walk of the sand's zeta, standard deviation after 1 s [-].
        doubt: Standard deviation of zeta at the start, from statics [-].
        wander: Random walk of the sinkage by mechanisms that the simulator lacks, standard
            deviation after 1 s [m].
        noise: Standard deviation of a reading [m].
        recovery: Time constant tau in which a gap decays [s].
        reach: Largest difference of zeta from the estimate for the sand [-].
        low, high: Bounds of zeta [-].
        settings: Limits of the derivatives; no number of a set-up file.
    """

    tick: Float[Array, ""] = eqx.field(converter=as_real, default=0.01)
    drift: Float[Array, ""] = eqx.field(converter=as_real, default=0.05)
    doubt: Float[Array, ""] = eqx.field(converter=as_real, default=0.1)
    wander: Float[Array, ""] = eqx.field(converter=as_real, default=2e-4)
    noise: Float[Array, ""] = eqx.field(converter=as_real, default=1e-4)
    recovery: Float[Array, ""] = eqx.field(converter=as_real, default=0.5)
    reach: Float[Array, ""] = eqx.field(converter=as_real, default=0.1)
    low: Float[Array, ""] = eqx.field(converter=as_real, default=0.05)
    high: Float[Array, ""] = eqx.field(converter=as_real, default=10.0)
    settings: KalmanSettings = eqx.field(static=True, default=DEFAULT_KALMAN)

    def __check_init__(self):
        require_between("tick", self.tick, 1e-5, LONGEST_TICK, " s")
        require_between("drift of zeta", self.drift, 0.0, LARGEST_ZETA)
        require_between("doubt of zeta", self.doubt, 0.0, LARGEST_ZETA)
        require_between("wander of the sinkage", self.wander, 0.0, 1.0, " m")
        require_between("noise of a reading", self.noise, 1e-9, 1.0, " m")
        require_between("recovery time", self.recovery, 1e-3, 1e6, " s")
        require_between("reach of zeta", self.reach, 0.0, LARGEST_ZETA)
        require_between("lowest zeta", self.low, 0.0, self.high)
        require_between("highest zeta", self.high, 0.0, LARGEST_ZETA)

    def begin(self, state: State, zeta: Float[Array, ""]) -> Belief:
        still, _ = ravel_pytree(jax.tree.map(jnp.zeros_like, _moving(state)))
        nought, one = jnp.zeros_like(zeta), jnp.ones_like(zeta)
        covariance = jnp.diag(jnp.stack([self.noise**2, self.doubt**2]))
        return Belief(nought, zeta, covariance, one, nought, _sinkage_direction(state), still)

    def tune(
        self, memory: Belief, zeta: Float[Array, ""], error: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Belief]:
        fresh = jnp.isfinite(error)
        innovation = jnp.where(fresh, error - memory.gap, 0.0)
        spread = memory.covariance
        gain = jnp.where(fresh, spread[:, 0] / (spread[0, 0] + self.noise**2), 0.0)
        gap = memory.gap + gain[0] * innovation
        strength = jnp.clip(memory.strength + gain[1] * innovation, self.low, self.high)
        posterior = spread - jnp.outer(gain, spread[0])
        # d+ = a d + b (believed - zeta) is to be the share of d that the recovery time leaves.
        share = jnp.exp(-self.tick / self.recovery)
        hold = self.settings.min_sinkage_rate * self.tick
        # A gap that closes faster by itself is left to do so.
        more = (
            jnp.maximum(memory.kept - share, 0.0)
            * gap
            * memory.gained
            / (memory.gained**2 + hold**2)
        )
        tuned = strength + jnp.clip(more, -self.reach, self.reach)
        tuned = jnp.where(fresh, jnp.clip(tuned, self.low, self.high), zeta)
        after = memory._replace(
            gap=gap, strength=strength, covariance=(posterior + posterior.T) / 2
        )
        return tuned, after

    def follow(
        self, memory: Belief, advance: Advance, state: State, zeta: Float[Array, ""]
    ) -> tuple[State, Output, Belief]:
        base, rebuild = ravel_pytree(_moving(state))

        def tick(flat: Float[Array, " state"], zeta: Float[Array, ""]):
            after, output = advance(eqx.combine(rebuild(flat), state), zeta)
            return ravel_pytree(_moving(after))[0], (after, output)

        def along(direction: Float[Array, " state"], change: Float[Array, ""]):
            return jax.jvp(tick, (base, zeta), (direction, change), has_aux=True)

        one, nought = jnp.ones_like(zeta), jnp.zeros_like(zeta)
        # The simulation itself does not depend on the direction, and is made once.
        _, carried, (after, output) = jax.vmap(along, out_axes=(None, 0, None))(
            jnp.stack([memory.slow, memory.fast]), jnp.stack([nought, one])
        )
        slow, fast = jnp.where(jnp.isfinite(carried), carried, 0.0)
        deeper_by_one = _sinkage_direction(state)
        deeper = jnp.vdot(deeper_by_one, slow)
        kept = jnp.clip(deeper, self.settings.min_retention, 1.0)
        gained = jnp.minimum(jnp.vdot(deeper_by_one, fast), 0.0)
        sound = deeper > self.settings.min_retention
        slow = jnp.where(sound, slow / jnp.where(sound, deeper, 1.0), deeper_by_one)
        fast = fast - jnp.vdot(deeper_by_one, fast) * slow

        transition = jnp.stack([jnp.stack([kept, gained]), jnp.stack([nought, one])])
        walk = self.tick * jnp.diag(jnp.stack([self.wander**2, self.drift**2]))
        belief = Belief(
            kept * memory.gap + gained * (memory.strength - zeta),
            memory.strength,
            transition @ memory.covariance @ transition.T + walk,
            kept,
            gained,
            slow,
            fast,
        )
        return after, output, belief


def _moving(state: State) -> State:
    """Differentiable part of a state: its floating arrays."""
    return eqx.filter(state, eqx.is_inexact_array)


def _sinkage_direction(state: State) -> Float[Array, " state"]:
    """Direction of the state in which only the sinkage grows, shape (state,)."""
    still = jax.tree.map(jnp.zeros_like, _moving(state))
    deeper = eqx.tree_at(lambda s: s.position, still, jnp.array([0.0, -1.0]))
    return ravel_pytree(deeper)[0]
