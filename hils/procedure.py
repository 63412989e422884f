"""One run from the first word to the rig until the file is closed.

    connect -> checks -> touch-down and zero -> ARM -> release, settle -> H_static, zeta(0)
    -> countdown -> the loop -> ramp-down -> STOP -> BYE -> file closed

Nothing can move before ARM. Whatever happens after it, STOP goes out, and the file is closed with
the reason why the run ended.
"""

import enum
import math
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from uuid import uuid4

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from drftjax import __version__
from drftjax.arrays import require_between
from drftjax.errors import InputError
from drftjax.runlog.head import Head, OnlineHead
from drftjax.saved import believed
from drftjax.setup import SetUp
from drftjax.statics import zeta_from_sinkage
from hils.clock import AbstractClock
from hils.events import EVENT_MEANINGS, FLAG_MEANINGS, Event
from hils.guard import CommandLimits, require_profile
from hils.link import AbstractLink, LinkLost, LinkQuality
from hils.loop import LoopReport, Overruns, TickLoop, Zero, channels
from hils.loop_setup import LoopRecord, LoopSetUp, Start, shared_physics
from hils.operator_dialogue import AbstractDialogue
from hils.pace import watchdog_ms
from hils.recorder import CLOSE_LIMIT
from hils.rest import Rest
from hils.rows import Rows
from hils.scene import Phase
from hils.session import STOPPED, RigStopped, Session
from hils.standing import Ended, Settled, Standing, touch_down
from hils.stop_request import StopRequest, Wish
from hils.tick import AbstractTick, FreeTick, LoopState, TunedTick
from hils.wire import VIRTUAL_RIG, Hello, HelloAck, RigState

# A rig may restart when its port is opened [s].
PATIENCE = 3.0
# zeta(0) outside of this says that something was measured or typed wrongly.
LEAST_ZETA, MOST_ZETA = 0.05, 10.0
LONGEST_COUNTDOWN = 60.0  # [s]
# A wheel that stands less deep was not let down, or was zeroed too low [m].
LEAST_SINKAGE = 5e-4
# The operator is told of a recording that takes so long to close [s].
SLOW_CLOSE = 3.0
# With zeta(0) given, a rig may be run that cannot tell touch-down, up to so far over it [m].
MOST_OVER = 0.02


class ZeroAt(enum.Enum):
    """Where the height counts from."""

    HELD = "held"  # the wheel is held where it touches the sand, and zeroed there
    POWER_UP = "power-up"  # the rig's own zero is touch-down already


@dataclass(frozen=True, kw_only=True)
class Procedure:
    """What a run is to be.

    Attributes:
        loop: The loop's numbers, the profile among them.
        free: Whether the carriage runs free and nothing is simulated: the paper's experiment
            driving.
        zero: Where the height counts from.
        zeta: zeta(0) [-]; None to tell it from the sinkage at rest.
        overruns: What follows a missed deadline.
        countdown: From the wheel's rest to the start [s].
        title: Of the run log.

    Raises:
        InputError: zeta or countdown is a number that cannot be.
    """

    loop: LoopSetUp
    free: bool = False
    zero: ZeroAt = ZeroAt.HELD
    zeta: float | None = None
    overruns: Overruns = Overruns.SKIP
    countdown: float = 3.0
    title: str = ""

    def __post_init__(self):
        require_between("countdown", self.countdown, 0.0, LONGEST_COUNTDOWN, " s")
        if self.zeta is not None:
            require_between("zeta0", self.zeta, LEAST_ZETA, MOST_ZETA)


@dataclass(frozen=True)
class RunReport:
    """How a run went.

    Attributes:
        reason: Why it ended; "completed" where the profile was run to its end.
        completed: Whether that is so.
        rested: Whether the rig was seen to rest at the end.
        settled: The wheel at rest before the run; None where it did not get so far.
        start: Sinkage at the start and zeta(0); None likewise.
        loop: How the loop went; None where it was not started.
        quality: What went over the link, from beginning to end.
        wish: Who asked for an end meanwhile, be it too late for the profile; None where nobody did.
        unfinished: Why the file could not be finished, and where its rows are; empty where it was.
    """

    reason: str
    completed: bool
    rested: bool
    settled: Settled | None
    start: Start | None
    loop: LoopReport | None
    quality: LinkQuality
    wish: Wish | None = None
    unfinished: str = ""


class _Log:
    """Events before the run's start is known, and after."""

    def __init__(self, rows: Rows, clock: AbstractClock):
        self._rows, self._clock = rows, clock
        self._early: list[tuple[float, int, float]] = []
        self._start: float | None = None

    def event(self, code: int, arg: float = 0.0) -> None:
        now = self._clock.now()
        if self._start is None:
            self._early.append((now, code, arg))
        else:
            self._rows.event(now - self._start, code, arg)

    def begin(self, start: float) -> None:
        self._start = start
        for time, code, arg in self._early:
            self._rows.event(time - start, code, arg)


def run(
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: Rows,
    dialogue: AbstractDialogue,
    stop: StopRequest,
    before_motion: Callable[[], None] = lambda: None,
) -> RunReport:
    """Make one run. The rows are closed and the rig is at rest, or was told to, when it returns.

    Args:
        procedure: What the run is to be.
        link, clock: The rig.
        rows: Takes what is recorded; not begun yet.
        dialogue: Whom to talk to.
        stop: Asks for the run's end; looked at from ARM on. From then on signals leave nothing
            but their wish; whoever has told of the run lets them interrupt again.
        before_motion: Called once when all is ready, before ARM.

    Raises:
        InputError: the run could not be begun; nothing moved, or the rig was told to rest. A file
            that could not be finished is in the report.
    """
    reason, report = "not begun", None
    try:
        report = _run(procedure, link, clock, rows, dialogue, stop, before_motion)
        reason = report.reason
    except InputError as error:
        reason = str(error)
        raise
    except Exception as error:
        reason = f"failed: {type(error).__name__}: {error}"
        raise InputError(f"the run failed by a fault of this program, {reason[8:]}") from error
    except BaseException as error:
        reason = f"failed: {type(error).__name__}"
        raise
    finally:
        unfinished = _close(rows, reason, dialogue)
        if unfinished and report is None:
            dialogue.tell(unfinished)
    assert report is not None  # or else it was raised
    return replace(report, wish=stop.wish, unfinished=unfinished)


def _close(rows: Rows, reason: str, dialogue: AbstractDialogue) -> str:
    """End the recording; why it could not be finished, empty where it was."""

    def tell() -> None:
        with suppress(OSError):  # the terminal may be gone
            dialogue.tell(f"The recording is being closed, for {CLOSE_LIMIT:.0f} s at most.")

    notice = threading.Timer(SLOW_CLOSE, tell)
    notice.start()
    try:
        rows.close(reason)
    except InputError as error:
        return str(error)
    finally:
        notice.cancel()
        notice.join()
    return ""


def _run(
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: Rows,
    dialogue: AbstractDialogue,
    stop: StopRequest,
    before_motion: Callable[[], None],
) -> RunReport:
    log, session = _Log(rows, clock), Session(link, clock)
    tick_us = round(procedure.loop.tick * 1e6)
    ack = session.connect(Hello(tick_us, watchdog_ms(tick_us)), PATIENCE)
    log.event(Event.CONNECTED, ack.boot_id)
    try:
        if ack.state in STOPPED:
            dialogue.tell(_stopped_before(ack.state))
        loop = _within(procedure.loop, ack, procedure.free)
        expected = Start(loop.setup.start.sinkage, 1.0)
        rows.require_room(_head(procedure, loop, expected, ack))
        statics = _statics(msgspec.json.encode(loop.setup))
        conduct = _conduct(loop, procedure.free)
        if isinstance(conduct, TunedTick):
            conduct.warm(expected)
        if procedure.zero is ZeroAt.HELD:
            dialogue.confirm(
                "Hold the wheel where its rim just touches the undisturbed sand",
                session.require_unhalted,
            )
        zero = touch_down(session, link, clock, ack)
        if procedure.zero is ZeroAt.POWER_UP:
            zero = zero._replace(z=0.0)
        log.event(Event.TOUCHED_DOWN, zero.z)
        dialogue.confirm(
            "Let the wheel down, so that it rests on the sand by its own weight",
            session.require_unhalted,
        )
        session.require_unhalted()
        before_motion()
    except BaseException:
        with suppress(LinkLost):
            session.bye()
        raise
    valid_ms = watchdog_ms(tick_us)
    driven = not procedure.free
    standing = Standing(session, link, clock, stop, loop.tick, driven, valid_ms, dialogue.show)
    ramp = loop.commands.omega / loop.ramp
    rest = Rest(session, link, clock, ack, stop, standing.rest, loop.tick, ramp)
    settled, start, looped, reason = None, None, None, "failed"
    rested = False
    try:
        stop.uncut = True
        dialogue.enter(Phase.SETTLING)
        session.arm(standing.rest)
        log.event(Event.ARMED)
        dialogue.tell("Armed. The wheel settles.")
        settled = standing.settle(zero)
        log.event(Event.SETTLED, settled.sinkage)
        start = _start(procedure, loop, statics, settled)
        dialogue.tell(
            _rest(procedure, start.sinkage)
            + ("" if procedure.free else f", zeta(0) {start.zeta:.4f}")
            + f"; start in {procedure.countdown:g} s"
        )
        dialogue.enter(Phase.COUNTDOWN, procedure.countdown)
        began = clock.now() + max(procedure.countdown, 2 * loop.tick)
        start = Start(standing.hold(began - loop.tick / 2, zero, settled), start.zeta)
        state = conduct.begin(start)
        rows.begin(_head(procedure, loop, start, ack))
        log.begin(began)
        looped = _loop(procedure, conduct, state, began, link, clock, rows, stop, zero, ack)
        reason = looped.reason
    except (Ended, RigStopped) as ended:
        reason = str(ended)
    except LinkLost as lost:
        reason = f"link lost: {lost}"
    finally:
        ends = frozenset() if looped is None else looped.ends
        rested = _to_rest(session, rest, ends, log, dialogue)
    return RunReport(
        reason,
        looped is not None and looped.completed,
        rested,
        settled,
        start,
        looped,
        link.quality(),
    )


def _loop(
    procedure: Procedure,
    conduct: AbstractTick,
    state: LoopState,
    began: float,
    link: AbstractLink,
    clock: AbstractClock,
    rows: Rows,
    stop: StopRequest,
    zero: Zero,
    ack: HelloAck,
) -> LoopReport:
    valid_ms = watchdog_ms(round(conduct.loop.tick * 1e6))
    return TickLoop(conduct, link, clock, rows, stop, zero, ack, procedure.overruns, valid_ms).run(
        state, began
    )


def _to_rest(
    session: Session,
    rest: Rest,
    ends: frozenset[tuple[int, float]],
    log: _Log,
    dialogue: AbstractDialogue,
) -> bool:
    """Bring the rig to rest and end the session; nothing that is told meanwhile can prevent it."""
    try:
        try:
            session.stop()
            log.event(Event.STOP_SENT)
            dialogue.enter(Phase.STOPPING)
        finally:
            rested = rest.bring(log.event, ends)
    except LinkLost:
        log.event(Event.LINK_LOST)
        dialogue.tell("The rig cannot be reached: its own watchdog brings it to rest.")
        return False
    log.event(Event.DISCONNECTED)
    if not rested:
        dialogue.tell("The rig has not confirmed that it rests: use its emergency stop.")
    return rested


# Before ARM ---------------------------------------------------------------------------------------


def _stopped_before(state: RigState) -> str:
    if state is RigState.FAULT:
        return "The rig says FAULT: it cannot be armed until that is mended."
    return "The rig was SAFE before this run; ARM lets it move again."


def _within(loop: LoopSetUp, ack: HelloAck, free: bool) -> LoopSetUp:
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
    readings = msgspec.structs.replace(loop.readings, lowest=deepest)
    return msgspec.structs.replace(loop, commands=both, readings=readings)


def _conduct(loop: LoopSetUp, free: bool) -> AbstractTick:
    return FreeTick(loop) if free else TunedTick(shared_physics(loop))


@lru_cache(maxsize=16)
def _statics(setup: bytes) -> Callable[[float], float]:
    """zeta by the sinkage at rest, compiled: after ARM nothing may take longer than a tick."""
    made = msgspec.json.decode(setup, type=SetUp)
    simulator, angle = made.trial().simulator, made.start.angle
    told = jax.jit(lambda sinkage: zeta_from_sinkage(simulator, sinkage, angle=angle))
    told = told.lower(jnp.asarray(0.01)).compile()
    return lambda sinkage: float(told(jnp.asarray(sinkage)))


def _rest(procedure: Procedure, sinkage: float) -> str:
    if procedure.free and sinkage < LEAST_SINKAGE:
        return "At rest in the air"
    return f"At rest {sinkage * 1e3:.2f} mm deep"


def _start(
    procedure: Procedure,
    loop: LoopSetUp,
    statics: Callable[[float], float],
    settled: Settled,
) -> Start:
    deepest = -loop.readings.lowest
    least = LEAST_SINKAGE if procedure.zeta is None else -MOST_OVER
    if procedure.free:
        least = -loop.readings.highest
    if not least <= settled.sinkage <= deepest:
        raise InputError(
            f"the wheel rests {settled.sinkage * 1e3:.2f} mm deep, must lie between "
            f"{least * 1e3:g} and {deepest * 1e3:.3g} mm: hold it at touch-down when it is zeroed, "
            "or give --zero power-up where the scale was zeroed there before, or --zeta0 where "
            "no sinkage at rest can be told"
        )
    if procedure.zeta is not None:
        return Start(settled.sinkage, procedure.zeta)
    if settled.sinkage < LEAST_SINKAGE:  # in the air, where statics tells nothing
        return Start(settled.sinkage, math.nan)
    zeta = statics(settled.sinkage)
    if not LEAST_ZETA <= zeta <= MOST_ZETA:
        raise InputError(
            f"a sinkage at rest of {settled.sinkage * 1e3:.2f} mm tells zeta(0) {zeta:.3g}, must "
            f"lie between {LEAST_ZETA:g} and {MOST_ZETA:g}: check touch-down, mass and wheel"
        )
    return Start(settled.sinkage, zeta)


def _head(procedure: Procedure, loop: LoopSetUp, start: Start, ack: HelloAck) -> Head:
    numbers = loop.tuner.build(loop.tick)
    online = OnlineHead(
        tick=loop.tick,
        zeta_step=float(getattr(numbers, "zeta_step", 0.0)),
        tolerance=float(getattr(numbers, "tolerance", 0.0)),
        loop=LoopRecord(loop, start).text(),
        flag_meanings=FLAG_MEANINGS,
    )
    return Head(
        setup=believed(loop.setup, start.sinkage, start.zeta),
        source="virtual rig" if ack.rig_id == VIRTUAL_RIG else "measured",
        title=procedure.title or loop.setup.title,
        channels=channels(ack.x_scale),
        driven=not procedure.free,
        online=None if procedure.free else online,
        event_meanings=EVENT_MEANINGS,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        run_id=uuid4().hex[:12],
        software="drftjax",
        software_version=__version__,
    )
