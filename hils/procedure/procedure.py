"""Procedure of one run, from HELLO until the file is closed.

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
from typing import NamedTuple

import msgspec

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.control.loop import Overruns, TickLoop
from hils.control.loop_config import LoopSetUp, Start
from hils.control.loop_report import LoopReport
from hils.control.measurements import DEFAULT_RESPONSE, ResponseSettings, TouchdownZero
from hils.control.run_end import DEFAULT_RAMP, RampSettings
from hils.control.safety import DEFAULT_SAFETY, MotionAtRest, SafetySettings
from hils.control.stop_request import StopReason, StopRequest
from hils.control.tick import AbstractTick
from hils.events import Event, Phase
from hils.link.link import AbstractLink, LinkLost, LinkQuality
from hils.link.messages import Drive, Hello, HelloAck, Measurement, RigState
from hils.link.timing import watchdog_ms
from hils.procedure.compilation import await_compilation, compiled_meanwhile
from hils.procedure.host_watch import HostWatch
from hils.procedure.initial_state import (
    DEFAULT_START_LIMITS,
    StartLimits,
    apply_rig_limits,
    rest_sentence,
    run_log_head,
    starting_point,
    within_limits,
    zeta_doubt,
)
from hils.procedure.operator_prompts import AbstractPrompts, signs_of_life
from hils.procedure.session import (
    DEFAULT_SESSION,
    STOPPED,
    RigStopped,
    Session,
    SessionSettings,
)
from hils.procedure.settling import (
    DEFAULT_SETTLING,
    DEFAULT_TOUCHDOWN,
    RunAborted,
    SettledWheel,
    SettlingSettings,
    StandingWheel,
    TouchdownSettings,
    touch_down,
)
from hils.procedure.shutdown import DEFAULT_SHUTDOWN, Shutdown, ShutdownSettings
from hils.recording.event_log import EventLog
from hils.recording.recorder import DEFAULT_RECORDER
from hils.recording.sinks import RowSink

LONGEST_COUNTDOWN = 60.0  # [s]


class ZeroAt(enum.Enum):
    """Origin of the height."""

    HELD = "held"  # the wheel is held where it touches the sand, and zeroed there
    POWER_UP = "power-up"  # the rig's own zero is touch-down already


@dataclass(frozen=True, kw_only=True)
class ProcedureSettings:
    """Deadlines and thresholds of a run, step by step.

    Attributes:
        session: Messages and their answers.
        touchdown: Zeroing of the wheel.
        settling: Rest on the sand.
        start: Sinkage and zeta(0) that are believed.
        response: Patience with a silent rig.
        ramp: End of the ramp to rest.
        shutdown: Rig at rest.
        safety: Safety rules.
        connect_time: Time over which HELLO is tried again [s]: a rig may restart when its port is
            opened.
        close_notice_time: Time after which the operator hears of a recording that takes long to
            close [s].
    """

    session: SessionSettings = DEFAULT_SESSION
    touchdown: TouchdownSettings = DEFAULT_TOUCHDOWN
    settling: SettlingSettings = DEFAULT_SETTLING
    start: StartLimits = DEFAULT_START_LIMITS
    response: ResponseSettings = DEFAULT_RESPONSE
    ramp: RampSettings = DEFAULT_RAMP
    shutdown: ShutdownSettings = DEFAULT_SHUTDOWN
    safety: SafetySettings = DEFAULT_SAFETY
    connect_time: float = 3.0
    close_notice_time: float = 3.0


DEFAULT_PROCEDURE = ProcedureSettings()


@dataclass(frozen=True, kw_only=True)
class Procedure:
    """Plan of a run.

    Attributes:
        loop: Numbers of the loop, the profile among them.
        free: True where the carriage runs free and nothing is simulated: the paper's experiment
            driving.
        zero: Origin of the height.
        zeta: zeta(0) [-]; None to compute it from the sinkage at rest.
        overruns: Policy for a missed deadline.
        countdown: From the wheel's rest to the start [s].
        title: Of the run log.
        settings: Deadlines and thresholds.

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
    settings: ProcedureSettings = DEFAULT_PROCEDURE

    def __post_init__(self):
        require_between("countdown", self.countdown, 0.0, LONGEST_COUNTDOWN, " s")
        if self.zeta is not None:
            limits = self.settings.start
            require_between("zeta0", self.zeta, limits.min_zeta, limits.max_zeta)


@dataclass(frozen=True)
class RunReport:
    """Outcome of a run.

    Attributes:
        reason: Reason of its end; "completed" where the profile was run to its end.
        completed: True where the profile was run to its end.
        rested: True where the rig was seen to rest at the end.
        settled: The wheel at rest before the run; None where it did not get so far.
        start: Sinkage at the start and zeta(0); None likewise.
        loop: Outcome of the loop; None where it was not started.
        quality: Traffic of the link, from beginning to end.
        stop_reason: Request for an end that came meanwhile, be it too late for the profile; None
            where there was none.
        unfinished: Reason why the file could not be finished, and the place of its rows; empty
            where it was finished.
        findings: Sentences on what was wrong though the run went on: safety rules that fired,
            sensors that were stuck.
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
    findings: tuple[str, ...] = ()


def run(
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: RowSink,
    prompts: AbstractPrompts,
    stop: StopRequest,
    before_motion: Callable[[], None] = lambda: None,
) -> RunReport:
    """Make one run. The rows are closed and the rig is at rest, or was asked to, when it returns.

    Args:
        procedure: Plan of the run.
        link, clock: The rig.
        rows: Takes what is recorded; not begun yet.
        prompts: To the operator.
        stop: Requests for the run's end, checked from ARM on. From then on signals leave nothing
            but their request, until the caller lets them interrupt again.
        before_motion: Called once when all is ready, before ARM.

    Raises:
        InputError: the run could not be begun; nothing moved, or the rig was asked to rest. A file
            that could not be finished is in the report.
    """
    reason, report = "not begun", None
    try:
        report = _Run(procedure, link, clock, rows, prompts, stop).make(before_motion)
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
        unfinished = _close(rows, reason, prompts, procedure.settings.close_notice_time)
        if unfinished and report is None and unfinished != reason:
            prompts.say(unfinished)
    assert report is not None  # or else it was raised
    request = stop.first_reason
    if request is not None and request.event is Event.EMERGENCY_STOP:
        request = request._replace(reason=stop.reason)
    return replace(report, stop_reason=request, unfinished=unfinished)


def _close(rows: RowSink, reason: str, prompts: AbstractPrompts, notice_time: float) -> str:
    """End the recording; the reason why it could not be finished, empty where it was."""

    def say() -> None:
        with suppress(OSError):  # the terminal may be gone
            limit = DEFAULT_RECORDER.close_time
            prompts.say(f"The recording is being closed, for {limit:.0f} s at most.")

    notice = threading.Timer(notice_time, say)
    notice.start()
    try:
        rows.close(reason)
    except InputError as error:
        return str(error)
    finally:
        notice.cancel()
        notice.join()
    return ""


class _Ready(NamedTuple):
    """A run that is ready for ARM.

    Attributes:
        ack: Answer of the rig to HELLO.
        loop: Within the rig's limits, with its integrator step.
        tick: Work of a tick, compiled.
        statics: zeta [-] by the sinkage at rest [m].
        zero: Counts at touch-down.
    """

    ack: HelloAck
    loop: LoopSetUp
    tick: AbstractTick
    statics: Callable[[float], float]
    zero: TouchdownZero


class _Run:
    """One run, and how far it has come."""

    def __init__(
        self,
        procedure: Procedure,
        link: AbstractLink,
        clock: AbstractClock,
        rows: RowSink,
        prompts: AbstractPrompts,
        stop: StopRequest,
    ):
        self._procedure, self._settings = procedure, procedure.settings
        self._link, self._clock, self._rows = link, clock, rows
        self._prompts, self._stop = prompts, stop
        self._log = EventLog(rows, clock)
        self._session = Session(link, clock, settings=self._settings.session)
        self._tick_us = round(procedure.loop.tick * 1e6)
        self._zeta_accepted = procedure.zeta is not None or procedure.free
        self._settled: SettledWheel | None = None
        self._start: Start | None = None
        self._looped: LoopReport | None = None

    def make(self, before_motion: Callable[[], None]) -> RunReport:
        """Make the run."""
        hello = Hello(self._tick_us, watchdog_ms(self._tick_us))
        with signs_of_life("Waiting for the rig to answer HELLO", self._prompts.say):
            ack = self._session.connect(hello, self._settings.connect_time)
        if late := self._session.late_answer:
            self._prompts.say(f"{late}.")
        self._log.event(Event.CONNECTED, ack.boot_id)
        try:
            ready = self._prepare(ack)
            before_motion()
        except BaseException:
            with suppress(LinkLost):
                self._session.bye()
            raise
        standing, shutdown = self._standing_wheel(ready), self._shutdown(ready)
        host = HostWatch(self._link, self._log, self._stop)
        reason, rested = "failed", False
        try:
            self._stop.uninterruptible = True
            reason = self._drive(ready, standing)
        except (RunAborted, RigStopped) as ended:
            reason = str(ended)
        except LinkLost as lost:
            reason = f"link lost: {lost}"
        finally:
            completed = self._looped is not None and self._looped.completed
            reason = host.explain(reason, completed, ack.watchdog_ms)
            rested = self._bring_to_rest(shutdown)
        return RunReport(
            reason,
            completed,
            rested,
            self._settled,
            self._start,
            self._looped,
            self._link.quality(),
            findings=(*(() if self._looped is None else self._looped.findings), *shutdown.findings),
        )

    # Before ARM ---------------------------------------------------------------------------------

    def _prepare(self, ack: HelloAck) -> _Ready:
        """Check everything, compile what is needed later, and zero the wheel at touch-down."""
        procedure, prompts, session = self._procedure, self._prompts, self._session
        if ack.state in STOPPED:
            prompts.say(_stopped_before(ack.state))
        loop = apply_rig_limits(procedure.loop, ack, procedure.free)
        expected = Start(loop.setup.start.sinkage, 1.0)
        head = run_log_head(loop, expected, ack, self._title, procedure.free, True)
        self._rows.require_room(head)
        with compiled_meanwhile(loop, procedure.free, expected) as compilation:
            if procedure.zero is ZeroAt.HELD:
                prompts.confirm(
                    "Hold the wheel where its rim just touches the undisturbed sand",
                    session.require_no_rig_stop,
                )
            touchdown, safety = self._settings.touchdown, self._settings.safety
            zero = touch_down(session, self._link, self._clock, ack, touchdown, safety)
            if procedure.zero is ZeroAt.POWER_UP:
                zero = zero._replace(z=0.0)
            self._log.event(Event.TOUCHED_DOWN, zero.z)
            prompts.confirm(
                "Let the wheel down, so that it rests on the sand by its own weight",
                session.require_no_rig_stop,
            )
            compiled = await_compilation(compilation, prompts.say, session.require_no_rig_stop)
        if compiled.step_choice is not None:
            prompts.say(str(compiled.step_choice))
        session.require_no_rig_stop()
        self._ask_about_zeta(compiled.loop, zero, compiled.statics)
        head = run_log_head(compiled.loop, expected, ack, self._title, procedure.free, True)
        self._rows.require_room(head)  # again: a question may stay open for long
        return _Ready(ack, compiled.loop, compiled.tick, compiled.statics, zero)

    def _ask_about_zeta(
        self, loop: LoopSetUp, zero: TouchdownZero, statics: Callable[[float], float]
    ) -> None:
        """Ask about a zeta(0) that is far from the set-up's, where the wheel stands on the sand
        before ARM already."""
        procedure, settings = self._procedure, self._settings
        if procedure.free or procedure.zeta is not None:
            return
        arrival = self._link.newest()
        if arrival is None or not isinstance(arrival.frame.message, Measurement):
            return
        sinkage = -zero.reading(arrival.frame.message, arrival.time).z
        if not settings.start.min_sinkage <= sinkage <= -loop.readings.lowest:
            return
        doubt = zeta_doubt(loop, Start(sinkage, statics(sinkage)), settings.safety)
        if doubt is None:
            return
        self._log.note(doubt.rule.event, doubt.value)
        if not self._prompts.accept(doubt.sentence):
            raise InputError(f"{doubt.sentence}; --zeta0 gives another start")
        self._zeta_accepted = True

    @property
    def _title(self) -> str:
        return self._procedure.title or self._procedure.loop.setup.title

    def _standing_wheel(self, ready: _Ready) -> StandingWheel:
        return StandingWheel(
            self._session,
            self._link,
            self._clock,
            self._stop,
            ready.loop.tick,
            not self._procedure.free,
            watchdog_ms(self._tick_us),
            self._prompts.show_sinkage,
            self._settings.settling,
            self._settings.response,
            MotionAtRest(ready.ack.x_scale, self._settings.safety),
        )

    def _shutdown(self, ready: _Ready) -> Shutdown:
        rest = Drive(0.0, 0.0, not self._procedure.free, watchdog_ms(self._tick_us))
        return Shutdown(
            self._session,
            self._link,
            self._clock,
            ready.ack,
            self._stop,
            self._log,
            rest,
            ready.loop.tick,
            ready.loop.commands.omega / ready.loop.ramp,
            self._settings.shutdown,
            self._settings.response,
            self._settings.safety,
        )

    # From ARM on --------------------------------------------------------------------------------

    def _drive(self, ready: _Ready, standing: StandingWheel) -> str:
        """Arm, settle, count down and run the loop; the reason of its end."""
        procedure, prompts, loop, clock = self._procedure, self._prompts, ready.loop, self._clock
        prompts.enter_phase(Phase.SETTLING)
        self._session.arm(standing.hold_command)
        self._log.event(Event.ARMED)
        prompts.say_if_free("Armed. The wheel settles.")
        settled = self._settled = standing.settle(ready.zero)
        self._log.event(Event.SETTLED, settled.sinkage)
        limits = self._settings.start
        start = self._start = starting_point(
            loop, settled, procedure.zeta, procedure.free, ready.statics, limits
        )
        doubt = None if self._zeta_accepted else zeta_doubt(loop, start, self._settings.safety)
        if doubt is not None:
            self._log.note(doubt.rule.event, doubt.value)
            raise RunAborted(f"{doubt.sentence}; --zeta0 {start.zeta:.3g} goes on with it")
        start = self._start = within_limits(start, limits)
        prompts.say_if_free(
            f"{rest_sentence(start, procedure.free, limits)}; start in {procedure.countdown:g} s"
        )
        prompts.enter_phase(Phase.COUNTDOWN, procedure.countdown)
        began = clock.now() + max(procedure.countdown, 2 * loop.tick)
        sinkage = standing.hold(began - loop.tick / 2, ready.zero, settled)
        start = self._start = Start(sinkage, start.zeta)
        readings = loop.readings.by_noise(settled.repeated, settled.interval)
        loop = msgspec.structs.replace(loop, readings=readings)
        tick, omega = ready.tick.with_readings(readings), settled.omega_measured
        state = tick.begin(start)
        head = run_log_head(loop, start, ready.ack, self._title, procedure.free, omega)
        self._rows.begin(head)
        self._log.begin(began)
        self._looped = self._tick_loop(ready, tick, omega).run(state, began)
        return self._looped.reason

    def _tick_loop(self, ready: _Ready, tick: AbstractTick, omega_measured: bool) -> TickLoop:
        return TickLoop(
            tick,
            self._link,
            self._clock,
            self._rows,
            self._log,
            self._stop,
            ready.zero,
            ready.ack,
            self._procedure.overruns,
            watchdog_ms(self._tick_us),
            self._settings.response,
            self._settings.ramp,
            self._settings.safety,
            omega_measured,
        )

    def _bring_to_rest(self, shutdown: Shutdown) -> bool:
        """Bring the rig to rest and end the session; no message meanwhile can prevent it."""
        try:
            try:
                self._session.stop()
                self._log.event(Event.STOP_SENT)
                self._prompts.enter_phase(Phase.STOPPING)
            finally:
                rested = shutdown.bring_to_rest()
        except LinkLost:
            self._log.note(Event.LINK_LOST)
            self._prompts.say("The rig cannot be reached: its own watchdog brings it to rest.")
            return False
        self._log.event(Event.DISCONNECTED)
        if not rested:
            self._prompts.say("The rig has not confirmed that it rests: use its emergency stop.")
        return rested


def _stopped_before(state: RigState) -> str:
    if state is RigState.FAULT:
        return "The rig says FAULT: it cannot be armed until that is mended."
    return "The rig was SAFE before this run; ARM lets it move again."
