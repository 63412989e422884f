"""Statics: the sinkage that carries a load, and the scaling factor that a sinkage tells.

Two wheels stand at the same load. One that is pushed straight down settles where its leading
plates carry the load (`INTRUSION`): this is the H_static that a test bed measures on touch-down,
and the zeta(0) of Table 3 of Fuke, Ishikawa & Ishigami 2024. One that no longer moves at all
(`REST`) carries less at the same depth, as the stress has no direction to follow.
"""

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from drftjax.common.arrays import as_real, require_between
from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.state import State
from drftjax.simulation.simulator import Simulator

# Descent [m/s]: far over the regulariser at rest, far below where the momentum flux counts.
INTRUSION = 1e-2


REST = 0.0


# Depth tolerance of the root [m]: a thousandth of a micrometre.
SINKAGE_TOLERANCE = 1e-9


def resting_load(simulator: Simulator, sinkage: ArrayLike) -> Float[Array, ""]:
    """What presses a wheel at rest into the sand [N]: its weight, and the loads of effects there.

    Args:
        simulator: Rig and effects.
        sinkage: H = -z [m].
    """
    state = State.at_rest(as_real(sinkage))
    still = jnp.zeros_like(state.time)
    return -simulator.held(state, Command(still, still, still))[1]


def vertical_support(
    simulator: Simulator,
    sinkage: ArrayLike,
    zeta: ArrayLike,
    angle: ArrayLike = 0.0,
    descent: float = INTRUSION,
) -> Float[Array, ""]:
    """Vertical force of the sand on a wheel that does not turn [N].

    Args:
        simulator: Wheel and terrain.
        sinkage: H = -z [m].
        zeta: Scaling factor [-].
        angle: Wheel angle [rad].
        descent: Speed straight down [m/s]: `INTRUSION` or `REST`.
    """
    depth = as_real(sinkage)
    nought = jnp.zeros_like(depth)
    return simulator.wrench(
        jnp.stack([nought, -depth]),
        jnp.stack([nought, nought - descent]),
        as_real(angle),
        nought,
        as_real(zeta),
    )[1]


def zeta_from_sinkage(
    simulator: Simulator,
    sinkage: ArrayLike,
    load: ArrayLike | None = None,
    angle: ArrayLike = 0.0,
    descent: float = INTRUSION,
) -> Float[Array, ""]:
    """Scaling factor at which the sand carries `load` at this sinkage [-]; differentiable.

    Args:
        simulator: Wheel, terrain and rig.
        sinkage: H = -z [m].
        load: Vertical load [N]; `resting_load` where none is given.
        angle: Wheel angle [rad]. At 0 both faces of the lowest grouser stand upright and carry, as
            n.p = 0 on them; turned ever so little, only one of them leads.
        descent: As in `vertical_support`.

    Raises:
        InputError: where the sinkage is not positive or beyond what the wheel's plates cover.
    """
    limit = simulator.wheel.cut().sinkage_limit
    require_between("sinkage", sinkage, 1e-6, limit, " m, all that the wheel's plates cover")
    load = resting_load(simulator, sinkage) if load is None else as_real(load)
    # The support is linear in zeta.
    without = vertical_support(simulator, sinkage, 0.0, angle, descent)
    with_one = vertical_support(simulator, sinkage, 1.0, angle, descent)
    return (load - without) / (with_one - without)


def sinkage_under_load(
    simulator: Simulator,
    zeta: ArrayLike,
    load: ArrayLike | None = None,
    angle: ArrayLike = 0.0,
    descent: float = INTRUSION,
) -> Float[Array, ""]:
    """Sinkage at which the sand carries `load` [m]; differentiable by the implicit function.

    Args:
        simulator: Wheel, terrain and rig.
        zeta: Scaling factor [-].
        load: Vertical load [N]; `resting_load` where none is given.
        angle: Wheel angle [rad].
        descent: As in `vertical_support`.

    Raises:
        RuntimeError: where the load sinks the wheel deeper than its plates cover.
    """
    load = None if load is None else as_real(load)
    return _sinkage_under(simulator.prepared(), as_real(zeta), load, as_real(angle), descent)


def standing_sinkage(simulator: Simulator, zeta: float, load: float | None = None) -> float:
    """Sinkage at which a wheel that was let down stands [m]: `sinkage_under_load` as a number.

    Args:
        simulator: Wheel, terrain and rig.
        zeta: Scaling factor [-].
        load: Vertical load [N]; `resting_load` where none is given.

    Raises:
        InputError: where the load sinks the wheel deeper than its plates cover.
    """
    limit = float(simulator.wheel.cut().sinkage_limit)
    most = float(vertical_support(simulator, limit, zeta))
    borne = float(resting_load(simulator, limit)) if load is None else load
    if not most > borne:
        raise InputError(
            f"sand with a zeta of {zeta:g} carries {most:.4g} N of this wheel at {1e3 * limit:.4g} "
            f"mm, as deep as its plates reach; its load is {borne:.4g} N, must be less"
        )
    return float(sinkage_under_load(simulator, zeta, load))


# Compiled as a whole: by itself the root finder would take each call for another program.
@eqx.filter_jit
def _sinkage_under(
    simulator: Simulator,
    zeta: Float[Array, ""],
    load: Float[Array, ""] | None,
    angle: Float[Array, ""],
    descent: float,
) -> Float[Array, ""]:
    def missing(sinkage: Float[Array, ""], given) -> Float[Array, ""]:
        simulator, zeta, load, angle = given
        load = resting_load(simulator, sinkage) if load is None else load
        return vertical_support(simulator, sinkage, zeta, angle, descent) / load - 1

    limit = simulator.wheel.cut().sinkage_limit
    deepest = optx.root_find(
        missing,
        optx.Bisection(rtol=SINKAGE_TOLERANCE, atol=SINKAGE_TOLERANCE),
        limit / 10,
        (simulator, zeta, load, angle),
        # A negative sinkage, with the grousers in the air, carries nothing.
        options={"lower": -limit / 2, "upper": limit},
        max_steps=64,
    )
    return deepest.value
