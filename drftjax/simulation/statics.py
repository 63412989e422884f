"""Statics: the sinkage that carries a load, and the scaling factor that follows from a sinkage.

Two wheels stand at the same load. One that is pushed straight down settles where its leading
plates carry the load (`INTRUSION`): this is the H_static that a test bed measures on touch-down,
and the zeta(0) of Table 3 of Fuke, Ishikawa & Ishigami 2024. One that no longer moves at all
(`REST`) carries less at the same depth, as the stress has no direction to follow.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
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


@dataclass(frozen=True)
class StaticsSettings:
    """Limits of the bisection for a sinkage.

    Attributes:
        tolerance: Of the sinkage [m], and of it as a share of itself: a thousandth of a micrometre.
        max_steps: Halvings of the interval.
        lower: Lower end of the interval, as a share of the deepest sinkage that the plates cover
            [-]; negative, as with the grousers in the air a wheel carries nothing.
    """

    tolerance: float = 1e-9
    max_steps: int = 64
    lower: float = -1 / 2


DEFAULT_STATICS = StaticsSettings()


def resting_load(simulator: Simulator, sinkage: ArrayLike) -> Float[Array, ""]:
    """Vertical load of a wheel at rest: its weight, and the loads of effects there.

    Args:
        simulator: Rig and effects.
        sinkage: H = -z [m], scalar.

    Returns:
        Load [N], positive downward.
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
    """Vertical force of the sand on a wheel that does not turn.

    Args:
        simulator: Wheel and terrain.
        sinkage: H = -z [m], scalar.
        zeta: Scaling factor [-].
        angle: Wheel angle [rad].
        descent: Speed straight down [m/s]: `INTRUSION` or `REST`.

    Returns:
        Force [N], positive upward.
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
    r"""Scaling factor at which the sand carries a load at this sinkage; differentiable.

    The support $S$ is linear in zeta: $\zeta = (F - S(0)) / (S(1) - S(0))$ for the load $F$.

    Args:
        simulator: Wheel, terrain and rig.
        sinkage: H = -z [m], scalar.
        load: Vertical load [N]; `resting_load` where none is given.
        angle: Wheel angle [rad]. At 0 both faces of the lowest grouser stand upright and carry, as
            n.p = 0 on them; turned ever so little, only one of them leads.
        descent: As in `vertical_support`.

    Returns:
        zeta [-], scalar.

    Raises:
        InputError: the sinkage is not positive or beyond what the wheel's plates cover.
    """
    limit = simulator.wheel.cut().sinkage_limit
    require_between("sinkage", sinkage, 1e-6, limit, " m, all that the wheel's plates cover")
    load = resting_load(simulator, sinkage) if load is None else as_real(load)
    without = vertical_support(simulator, sinkage, 0.0, angle, descent)
    with_one = vertical_support(simulator, sinkage, 1.0, angle, descent)
    return (load - without) / (with_one - without)


def sinkage_under_load(
    simulator: Simulator,
    zeta: ArrayLike,
    load: ArrayLike | None = None,
    angle: ArrayLike = 0.0,
    descent: float = INTRUSION,
    settings: StaticsSettings = DEFAULT_STATICS,
) -> Float[Array, ""]:
    """Sinkage at which the sand carries a load; differentiable by the implicit function theorem.

    Args:
        simulator: Wheel, terrain and rig.
        zeta: Scaling factor [-].
        load: Vertical load [N]; `resting_load` where none is given.
        angle: Wheel angle [rad].
        descent: As in `vertical_support`.
        settings: Limits of the bisection.

    Returns:
        Sinkage [m], scalar.

    Raises:
        RuntimeError: the load sinks the wheel deeper than its plates cover.
    """
    load = None if load is None else as_real(load)
    return _sinkage_under(
        simulator.prepared(), as_real(zeta), load, as_real(angle), descent, settings
    )


def standing_sinkage(simulator: Simulator, zeta: float, load: float | None = None) -> float:
    """Sinkage of a wheel that was let down and stands [m]: `sinkage_under_load` as a number.

    Args:
        simulator: Wheel, terrain and rig.
        zeta: Scaling factor [-].
        load: Vertical load [N]; `resting_load` where none is given.

    Raises:
        InputError: the load sinks the wheel deeper than its plates cover.
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
    settings: StaticsSettings,
) -> Float[Array, ""]:
    """Sinkage [m] by bisection of the support less the load, as a share of the load."""
    import optimistix as optx  # here, for a run in the loop needs none of it and starts sooner

    def missing(sinkage: Float[Array, ""], given) -> Float[Array, ""]:
        simulator, zeta, load, angle = given
        load = resting_load(simulator, sinkage) if load is None else load
        return vertical_support(simulator, sinkage, zeta, angle, descent) / load - 1

    limit = simulator.wheel.cut().sinkage_limit
    deepest = optx.root_find(
        missing,
        optx.Bisection(rtol=settings.tolerance, atol=settings.tolerance),
        limit / 10,
        (simulator, zeta, load, angle),
        options={"lower": limit * settings.lower, "upper": limit},
        max_steps=settings.max_steps,
    )
    return deepest.value
