"""One run from the first word to the rig until the file is closed.

    connect -> checks -> touch-down and zero -> ARM -> release, settle -> H_static, zeta(0)
    -> countdown -> the loop -> ramp-down -> STOP -> BYE -> file closed

Nothing can move before ARM. Whatever happens after it, STOP goes out, and the file is closed with
the reason why the run ended.
"""

import enum
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import msgspec

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.control.event_log import EventLog
from hils.control.loop import LoopReport, Overruns, TickLoop
from hils.control.loop_config import LoopSetUp, Start, shared_physics
from hils.control.stop_request import StopReason, StopRequest
from hils.control.tick import AbstractTick, FreeTick, TunedTick
from hils.events import Event, Phase
from hils.link.link import AbstractLink, LinkLost, LinkQuality
from hils.link.messages import Hello, RigState
from hils.link.timing import watchdog_ms
from hils.procedure.initial_state import (
    LEAST_SINKAGE,
    LEAST_ZETA,
    MOST_ZETA,
    apply_rig_limits,
    run_log_head,
    starting_point,
    zeta_by_sinkage,
)
from hils.procedure.operator_prompts import AbstractPrompts
from hils.procedure.session import STOPPED, RigStopped, Session
from hils.procedure.settling import RunAborted, SettledWheel, StandingWheel, touch_down
from hils.procedure.shutdown import Shutdown
from hils.recording.recorder import CLOSE_LIMIT
from hils.recording.sinks import RowSink

# A rig may restart when its port is opened [s].
PATIENCE = 3.0


LONGEST_COUNTDOWN = 60.0  # [s]


# The operator is told of a recording that takes so long to close [s].
SLOW_CLOSE = 3.0


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
    settled: SettledWheel | None
    start: Start | None
    loop: LoopReport | None
    quality: LinkQuality
    stop_reason: StopReason | None = None
    unfinished: str = ""


def run(
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: RowSink,
    prompts: AbstractPrompts,
    stop: StopRequest,
    before_motion: Callable[[], None] = lambda: None,
) -> RunReport:
    """Make one run. The rows are closed and the rig is at rest, or was told to, when it returns.

    Args:
        procedure: What the run is to be.
        link, clock: The rig.
        rows: Takes what is recorded; not begun yet.
        prompts: Whom to talk to.
        stop: Asks for the run's end; looked at from ARM on. From then on signals leave nothing
            but their wish; whoever has told of the run lets them interrupt again.
        before_motion: Called once when all is ready, before ARM.

    Raises:
        InputError: the run could not be begun; nothing moved, or the rig was told to rest. A file
            that could not be finished is in the report.
    """
    reason, report = "not begun", None
    try:
        report = _run(procedure, link, clock, rows, prompts, stop, before_motion)
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
        unfinished = _close(rows, reason, prompts)
        if unfinished and report is None and unfinished != reason:
            prompts.say(unfinished)
    assert report is not None  # or else it was raised
    wish = stop.first_reason
    if wish is not None and wish.event is Event.EMERGENCY_STOP:
        wish = wish._replace(reason=stop.reason)
    return replace(report, stop_reason=wish, unfinished=unfinished)


def _close(rows: RowSink, reason: str, prompts: AbstractPrompts) -> str:
    """End the recording; why it could not be finished, empty where it was."""

    def tell() -> None:
        with suppress(OSError):  # the terminal may be gone
            prompts.say(f"The recording is being closed, for {CLOSE_LIMIT:.0f} s at most.")

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
    rows: RowSink,
    prompts: AbstractPrompts,
    stop: StopRequest,
    before_motion: Callable[[], None],
) -> RunReport:
    log, session = EventLog(rows, clock), Session(link, clock)
    tick_us = round(procedure.loop.tick * 1e6)
    ack = session.connect(Hello(tick_us, watchdog_ms(tick_us)), PATIENCE)
    log.event(Event.CONNECTED, ack.boot_id)
    try:
        if ack.state in STOPPED:
            prompts.say(_stopped_before(ack.state))
        title = procedure.title or procedure.loop.setup.title
        loop = apply_rig_limits(procedure.loop, ack, procedure.free)
        expected = Start(loop.setup.start.sinkage, 1.0)
        head = run_log_head(loop, expected, ack, title, procedure.free)
        rows.require_room(head)
        statics = zeta_by_sinkage(msgspec.json.encode(loop.setup))
        conduct = _conduct(loop, procedure.free)
        if isinstance(conduct, TunedTick):
            conduct.precompile(expected)
        if procedure.zero is ZeroAt.HELD:
            prompts.confirm(
                "Hold the wheel where its rim just touches the undisturbed sand",
                session.require_no_rig_stop,
            )
        zero = touch_down(session, link, clock, ack)
        if procedure.zero is ZeroAt.POWER_UP:
            zero = zero._replace(z=0.0)
        log.event(Event.TOUCHED_DOWN, zero.z)
        prompts.confirm(
            "Let the wheel down, so that it rests on the sand by its own weight",
            session.require_no_rig_stop,
        )
        session.require_no_rig_stop()
        rows.require_room(head)  # again: a question may stay open for long
        before_motion()
    except BaseException:
        with suppress(LinkLost):
            session.bye()
        raise
    valid_ms = watchdog_ms(tick_us)
    driven = not procedure.free
    standing = StandingWheel(
        session, link, clock, stop, loop.tick, driven, valid_ms, prompts.show_sinkage
    )
    ramp = loop.commands.omega / loop.ramp
    rest = Shutdown(session, link, clock, ack, stop, log, standing.hold_command, loop.tick, ramp)
    settled, start, looped, reason = None, None, None, "failed"
    rested = False
    try:
        stop.uninterruptible = True
        prompts.enter_phase(Phase.SETTLING)
        session.arm(standing.hold_command)
        log.event(Event.ARMED)
        prompts.say_if_free("Armed. The wheel settles.")
        settled = standing.settle(zero)
        log.event(Event.SETTLED, settled.sinkage)
        start = starting_point(loop, settled, procedure.zeta, procedure.free, statics)
        prompts.say_if_free(f"{_at_rest(procedure, start)}; start in {procedure.countdown:g} s")
        prompts.enter_phase(Phase.COUNTDOWN, procedure.countdown)
        began = clock.now() + max(procedure.countdown, 2 * loop.tick)
        start = Start(standing.hold(began - loop.tick / 2, zero, settled), start.zeta)
        state = conduct.begin(start)
        rows.begin(run_log_head(loop, start, ack, title, procedure.free))
        log.begin(began)
        ticks = TickLoop(
            conduct, link, clock, rows, log, stop, zero, ack, procedure.overruns, valid_ms
        )
        looped = ticks.run(state, began)
        reason = looped.reason
    except (RunAborted, RigStopped) as ended:
        reason = str(ended)
    except LinkLost as lost:
        reason = f"link lost: {lost}"
    finally:
        rested = _to_rest(session, rest, log, prompts)
    return RunReport(
        reason,
        looped is not None and looped.completed,
        rested,
        settled,
        start,
        looped,
        link.quality(),
    )


def _to_rest(session: Session, rest: Shutdown, log: EventLog, prompts: AbstractPrompts) -> bool:
    """Bring the rig to rest and end the session; nothing that is told meanwhile can prevent it."""
    try:
        try:
            session.stop()
            log.event(Event.STOP_SENT)
            prompts.enter_phase(Phase.STOPPING)
        finally:
            rested = rest.bring_to_rest()
    except LinkLost:
        log.note(Event.LINK_LOST)
        prompts.say("The rig cannot be reached: its own watchdog brings it to rest.")
        return False
    log.event(Event.DISCONNECTED)
    if not rested:
        prompts.say("The rig has not confirmed that it rests: use its emergency stop.")
    return rested


def _stopped_before(state: RigState) -> str:
    if state is RigState.FAULT:
        return "The rig says FAULT: it cannot be armed until that is mended."
    return "The rig was SAFE before this run; ARM lets it move again."


def _conduct(loop: LoopSetUp, free: bool) -> AbstractTick:
    return FreeTick(loop) if free else TunedTick(shared_physics(loop))


def _at_rest(procedure: Procedure, start: Start) -> str:
    if procedure.free and start.sinkage < LEAST_SINKAGE:
        return "At rest in the air"
    depth = f"At rest {start.sinkage * 1e3:.2f} mm deep"
    return depth if procedure.free else f"{depth}, zeta(0) {start.zeta:.4f}"
