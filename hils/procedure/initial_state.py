"""Start of a run: the loop within the rig's limits, sinkage and zeta(0), the run log's head."""

import math
from collections.abc import Callable
from dataclasses import dataclass
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
from hils.control.safety import DEFAULT_SAFETY, Finding, SafetyRule, SafetySettings
from hils.events import EVENT_MEANINGS, FLAG_MEANINGS
from hils.link.messages import VIRTUAL_RIG, HelloAck
from hils.procedure.settling import SettledWheel


@dataclass(frozen=True)
class StartLimits:
    """Values at the start that can be believed.

    Attributes:
        min_zeta, max_zeta: zeta(0) outside of these says that something was measured or typed
            wrongly [-].
        min_sinkage: A wheel that stands less deep was not let down, or was zeroed too low [m].
        max_height: Height over touch-down up to which a rig that cannot measure touch-down may be
            run with zeta(0) given [m].
    """

    min_zeta: float = 0.05
    max_zeta: float = 20.0
    min_sinkage: float = 5e-4
    max_height: float = 0.02


DEFAULT_START_LIMITS = StartLimits()


def apply_rig_limits(loop: LoopSetUp, ack: HelloAck, free: bool) -> LoopSetUp:
    """Narrow the limits of a loop to the rig's own.

    Args:
        loop: As it was asked for.
        ack: Answer of the rig to HELLO.
        free: True where the carriage runs free.

    Raises:
        InputError: the profile does not fit the rig.
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
    """Compile zeta [-] as a function of the sinkage at rest [m], by static equilibrium.

    It is compiled beforehand: after ARM nothing may take longer than a tick.

    Args:
        setup: A `drftjax.setups.setup.SetUp` as JSON.
    """
    made = msgspec.json.decode(setup, type=SetUp)
    simulator, angle = made.trial().simulator, made.start.angle
    zeta = jax.jit(lambda sinkage: zeta_from_sinkage(simulator, sinkage, angle=angle))
    compiled = zeta.lower(jnp.asarray(0.01)).compile()
    return lambda sinkage: float(compiled(jnp.asarray(sinkage)))


def starting_point(
    loop: LoopSetUp,
    settled: SettledWheel,
    zeta: float | None,
    free: bool,
    statics: Callable[[float], float],
    limits: StartLimits = DEFAULT_START_LIMITS,
) -> Start:
    """Sinkage and zeta at the start of the simulation.

    Args:
        loop: Within the rig's limits.
        settled: The wheel at rest.
        zeta: zeta(0) [-]; None to compute it from the sinkage.
        free: True where nothing is simulated, so that the wheel may hang in the air.
        statics: zeta [-] by the sinkage [m].
        limits: Values that can be believed.

    Raises:
        InputError: the sinkage cannot be believed, or gives no zeta(0).
    """
    deepest = -loop.readings.lowest
    least = limits.min_sinkage if zeta is None else -limits.max_height
    if free:
        least = -loop.readings.highest
    if not least <= settled.sinkage <= deepest:
        raise InputError(
            f"the wheel rests {settled.sinkage * 1e3:.2f} mm deep, must lie between "
            f"{least * 1e3:g} and {deepest * 1e3:.3g} mm: hold it at touch-down when it is zeroed, "
            "look at the sign of z_scale, give --zero power-up where the scale was zeroed there "
            "before, or --zeta0 where no sinkage at rest can be measured"
        )
    if zeta is not None:
        return Start(settled.sinkage, zeta)
    if settled.sinkage < limits.min_sinkage:  # in the air, where statics has no answer
        return Start(settled.sinkage, math.nan)
    zeta = statics(settled.sinkage)
    if not math.isfinite(zeta):
        raise InputError(
            f"a sinkage at rest of {settled.sinkage * 1e3:.2f} mm gives no zeta(0): check mass and "
            "wheel, or give --zeta0"
        )
    return Start(settled.sinkage, zeta)


def within_limits(start: Start, limits: StartLimits = DEFAULT_START_LIMITS) -> Start:
    """The start with its zeta(0) within the limits, of a run that is made in spite of a doubt.

    Args:
        start: By `starting_point`.
        limits: Values that can be believed.
    """
    if math.isnan(start.zeta):
        return start
    return Start(start.sinkage, min(max(start.zeta, limits.min_zeta), limits.max_zeta))


def rest_sentence(start: Start, free: bool, limits: StartLimits = DEFAULT_START_LIMITS) -> str:
    """Words for the wheel at rest.

    Args:
        start: By `starting_point`.
        free: True where nothing is simulated, so that the wheel may hang in the air.
        limits: Values that can be believed.
    """
    if free and start.sinkage < limits.min_sinkage:
        return "At rest in the air"
    depth = f"At rest {start.sinkage * 1e3:.2f} mm deep"
    return depth if free else f"{depth}, zeta(0) {start.zeta:.4f}"


def zeta_doubt(
    loop: LoopSetUp,
    start: Start,
    safety: SafetySettings = DEFAULT_SAFETY,
    limits: StartLimits = DEFAULT_START_LIMITS,
) -> Finding | None:
    """A zeta(0) by statics that is far from the set-up's, or that no sand has; None otherwise.

    Args:
        loop: Within the rig's limits.
        start: By `starting_point`, from the sinkage at rest.
        safety: Numbers of the rule.
        limits: Values that can be believed.
    """
    if math.isnan(start.zeta):
        return None
    believed = loop.setup.terrain.zeta
    against = []
    if isinstance(believed, float) and believed > 0:
        ratio = start.zeta / believed
        if not 1 / safety.zeta_factor <= ratio <= safety.zeta_factor:
            against.append(f"the set-up says {believed:.3g}")
    if not limits.min_zeta <= start.zeta <= limits.max_zeta:
        against.append(f"sand has {limits.min_zeta:g} to {limits.max_zeta:g}")
    if not against:
        return None
    sentence = (
        f"a sinkage at rest of {start.sinkage * 1e3:.2f} mm gives zeta(0) {start.zeta:.3g}, "
        f"{' and '.join(against)}: the rig's z_scale, the sign of z, touch-down or the mass is "
        "wrong, or the sand is another"
    )
    return Finding(SafetyRule.ZETA_DOUBTED, sentence, start.zeta)


def run_log_head(
    loop: LoopSetUp, start: Start, ack: HelloAck, title: str, free: bool, omega: bool
) -> Head:
    """Head of the run log: all that is known of the run before its first row.

    Args:
        loop: Within the rig's limits.
        start: Sinkage and zeta at the start.
        ack: Answer of the rig to HELLO.
        title: Of the run.
        free: True where the carriage runs free.
        omega: True where the rig measures its wheel's speed.
    """
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
        channels=measured_channels(ack.x_scale, omega),
        driven=not free,
        online=None if free else online,
        event_meanings=EVENT_MEANINGS,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        run_id=uuid4().hex[:12],
        software="drftjax",
        software_version=__version__,
    )
