"""What a run begins from: a loop within the rig's limits, the wheel at rest, the run log's head."""

import math
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache
from uuid import uuid4

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.runlog.header import Head, OnlineHead
from drftjax.setups.setup import SetUp
from drftjax.setups.simulated_run import with_believed_values
from drftjax.simulation.statics import zeta_from_sinkage
from hils.control.limits import CommandLimits, require_profile
from hils.control.loop_config import LoopRecord, LoopSetUp, Start
from hils.control.measurements import measured_channels
from hils.events import EVENT_MEANINGS, FLAG_MEANINGS
from hils.link.messages import VIRTUAL_RIG, HelloAck
from hils.procedure.settling import SettledWheel

# zeta(0) outside of this says that something was measured or typed wrongly.
LEAST_ZETA, MOST_ZETA = 0.05, 10.0


# A wheel that stands less deep was not let down, or was zeroed too low [m].
LEAST_SINKAGE = 5e-4


# With zeta(0) given, a rig may be run that cannot tell touch-down, up to so far over it [m].
MOST_OVER = 0.02


def apply_rig_limits(loop: LoopSetUp, ack: HelloAck, free: bool) -> LoopSetUp:
    """The loop within the rig's own limits.

    Raises:
        InputError: what of the rig or of the profile does not fit.
    """
    command = loop.setup.command.build()
    rig = msgspec.structs.replace(loop.commands, omega=ack.omega_max, vx=ack.vx_max)
    require_profile(command.time, command.omega, rig, "the rig")
    both = CommandLimits(
        min(loop.commands.omega, ack.omega_max),
        min(loop.commands.vx, ack.vx_max),
        loop.commands.omega_slew,
        loop.commands.vx_slew,
    )
    rolling = loop.setup.wheel.radius * float(np.abs(command.omega).max())
    if not free and rolling > both.vx:
        raise InputError(
            f"the profile rolls at up to {rolling:.4g} m/s without slip, the carriage may be "
            f"driven at {both.vx:.4g} m/s at most (the rig allows {ack.vx_max:.4g} m/s)"
        )
    deepest = -float(loop.setup.trial().simulator.wheel.cut().sinkage_limit)
    # A free carriage rolls as fast as its wheel; nothing is twice as fast as both may be.
    fastest = 2 * max(both.vx, loop.setup.wheel.radius * both.omega)
    readings = msgspec.structs.replace(loop.readings, lowest=deepest, fastest_x=fastest)
    return msgspec.structs.replace(loop, commands=both, readings=readings)


@lru_cache(maxsize=16)
def zeta_by_sinkage(setup: bytes) -> Callable[[float], float]:
    """zeta by the sinkage at rest, compiled: after ARM nothing may take longer than a tick."""
    made = msgspec.json.decode(setup, type=SetUp)
    simulator, angle = made.trial().simulator, made.start.angle
    told = jax.jit(lambda sinkage: zeta_from_sinkage(simulator, sinkage, angle=angle))
    told = told.lower(jnp.asarray(0.01)).compile()
    return lambda sinkage: float(told(jnp.asarray(sinkage)))


def starting_point(
    loop: LoopSetUp,
    settled: SettledWheel,
    zeta: float | None,
    free: bool,
    statics: Callable[[float], float],
) -> Start:
    """What the simulation starts from.

    Args:
        loop: Within the rig's limits.
        settled: The wheel at rest.
        zeta: zeta(0) [-]; None to tell it from the sinkage.
        free: Whether nothing is simulated, so that the wheel may hang in the air.
        statics: Tells zeta [-] by the sinkage [m].

    Raises:
        InputError: the wheel cannot rest so deep, or zeta(0) cannot be what it tells.
    """
    deepest = -loop.readings.lowest
    least = LEAST_SINKAGE if zeta is None else -MOST_OVER
    if free:
        least = -loop.readings.highest
    if not least <= settled.sinkage <= deepest:
        raise InputError(
            f"the wheel rests {settled.sinkage * 1e3:.2f} mm deep, must lie between "
            f"{least * 1e3:g} and {deepest * 1e3:.3g} mm: hold it at touch-down when it is zeroed, "
            "or give --zero power-up where the scale was zeroed there before, or --zeta0 where "
            "no sinkage at rest can be told"
        )
    if zeta is not None:
        return Start(settled.sinkage, zeta)
    if settled.sinkage < LEAST_SINKAGE:  # in the air, where statics tells nothing
        return Start(settled.sinkage, math.nan)
    zeta = statics(settled.sinkage)
    if not LEAST_ZETA <= zeta <= MOST_ZETA:
        raise InputError(
            f"a sinkage at rest of {settled.sinkage * 1e3:.2f} mm tells zeta(0) {zeta:.3g}, must "
            f"lie between {LEAST_ZETA:g} and {MOST_ZETA:g}: check touch-down, mass and wheel"
        )
    return Start(settled.sinkage, zeta)


def run_log_head(loop: LoopSetUp, start: Start, ack: HelloAck, title: str, free: bool) -> Head:
    """What the run log says of the run before its first row."""
    numbers = loop.tuner.build(loop.tick)
    online = OnlineHead(
        tick=loop.tick,
        zeta_step=float(getattr(numbers, "zeta_step", 0.0)),
        tolerance=float(getattr(numbers, "tolerance", 0.0)),
        loop=LoopRecord(loop, start).text(),
        flag_meanings=FLAG_MEANINGS,
    )
    return Head(
        setup=with_believed_values(loop.setup, start.sinkage, start.zeta),
        source="virtual rig" if ack.rig_id == VIRTUAL_RIG else "measured",
        title=title,
        channels=measured_channels(ack.x_scale),
        driven=not free,
        online=None if free else online,
        event_meanings=EVENT_MEANINGS,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        run_id=uuid4().hex[:12],
        software="drftjax",
        software_version=__version__,
    )
