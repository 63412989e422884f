"""The tick loop: absolute deadlines, the newest reading in, a command out, everything recorded."""

import enum

from hils.clock import AbstractClock
from hils.control.limits import Verdict
from hils.control.loop_report import LoopReport, LoopStatistics
from hils.control.measurements import (
    DEFAULT_RESPONSE,
    MeasurementTracker,
    PolledReading,
    ResponseSettings,
    RigUnresponsive,
    SensorFaults,
    TouchdownZero,
    measured_channels,
)
from hils.control.run_end import DEFAULT_RAMP, RampSettings, RunEnd
from hils.control.safety import DEFAULT_SAFETY, Action, Finding, SafetyMonitor, SafetySettings
from hils.control.schedule import TickSchedule
from hils.control.stop_request import StopReason, StopRequest
from hils.control.tick import AbstractTick, LoopState, TickInput, TickOutput
from hils.control.tick_record import TickRecord
from hils.events import Event
from hils.link.link import AbstractLink
from hils.link.messages import Drive, HelloAck
from hils.recording.event_log import EventLog
from hils.recording.sinks import RowSink


class Overruns(enum.Enum):
    """Policy for a missed deadline."""

    SKIP = "skip"  # the ticks missed are simulated with the last command held, and it goes on
    STOP = "stop"


class TickLoop:
    """One run of the loop.

    Args:
        tick: Work of a tick, with the numbers of the loop.
        link: To the rig.
        clock: Time of the link's arrivals.
        rows: Takes what is recorded.
        log: Takes events; it knows the start of the run.
        stop: Requests to end the run, checked on each tick.
        zero: Counts at touch-down.
        ack: Answer of the rig to HELLO.
        overruns: Policy for a missed deadline.
        valid_ms: Time for which the rig may hold a command [ms].
        response: Patience with a silent rig.
        ramp: End of the ramp to rest.
        safety: Numbers of the safety rules.
        omega_measured: True where the rig measures its wheel's speed.
    """

    def __init__(
        self,
        tick: AbstractTick,
        link: AbstractLink,
        clock: AbstractClock,
        rows: RowSink,
        log: EventLog,
        stop: StopRequest,
        zero: TouchdownZero,
        ack: HelloAck,
        overruns: Overruns,
        valid_ms: int,
        response: ResponseSettings = DEFAULT_RESPONSE,
        ramp: RampSettings = DEFAULT_RAMP,
        safety: SafetySettings = DEFAULT_SAFETY,
        omega_measured: bool = True,
    ):
        period = tick.loop.tick
        self._tick, self._link, self._log = tick, link, log
        self._overruns, self._valid_ms = overruns, valid_ms
        self._schedule = TickSchedule(clock, period)
        self._tracker = MeasurementTracker(link, log, zero, ack, period, response)
        self._sensors = SensorFaults(log)
        channels = measured_channels(zero.x_scale, omega_measured)
        self._record = TickRecord(rows, channels, tick.driven, period)
        self._safety = SafetyMonitor(tick.loop, tick.driven, safety)
        self._findings: list[Finding] = []
        self._end = RunEnd(tick, link, rows, log, stop, ramp)
        self._statistics = LoopStatistics(self._end.most_ticks)

    def run(self, state: LoopState, start: float) -> LoopReport:
        """Run the profile.

        Args:
            state: Before the first tick.
            start: Due time of the first tick, in the clock's time [s].

        Raises:
            LinkLost: the rig can no longer be reached.
        """
        self._schedule.begin(start)
        self._tracker.begin(start)
        dropped = self._link.quality().dropped
        self._record.begin(state.packed[1])
        try:
            while not self._end.is_finished(state):
                state = self._make_tick(state)
        except RigUnresponsive as error:
            reason, completed = str(error), False
        else:
            self._schedule.sleep_until(state.number)
            request = self._end.reason
            reason, completed = ("completed", True) if request is None else (request.reason, False)
            self._log.event(Event.PROFILE_ENDED if completed else Event.RAMPED_DOWN)
        dropped = self._link.quality().dropped - dropped
        if dropped:
            self._log.event(Event.FRAMES_DROPPED, dropped)
        findings = (*(each.sentence for each in self._findings), *self._sensors.sentences)
        return LoopReport(reason, completed, self._statistics, state, findings)

    def _make_tick(self, state: LoopState) -> LoopState:
        if self._schedule.wait_to_warm_up(state.number):
            self._tick.step(state, TickInput(None))
        start = self._schedule.wait_for(state.number)
        if start.skipped:
            self._handle_overrun(self._schedule.lateness(start, start.woken), start.skipped)
        self._end.check_requests()
        polled = self._tracker.poll(start.woken)
        ramping = self._end.ramps_at(start.number)
        given = TickInput(polled.reading, start.skipped, ramping, polled.answers_old_command)
        state, output = self._tick.step(state, given)
        seq = self._send(output)
        sent = self._schedule.now()
        overrun = self._schedule.overrun(start, sent)
        if overrun > 0.0:
            self._handle_overrun(overrun, 0)
        # A tick that was skipped had its deadline too.
        late = max(0.0, self._schedule.lateness(start, sent))
        times = sent - start.woken, start.woken - start.due
        flags = self._sensors.flags
        self._record.write(output, polled, seq, late, start.skipped, ramping, flags, *times)
        self._check_readings(state, output, polled)
        self._count(times, output, polled)
        for each in self._safety.find(output, state.watch, polled, ramping):
            self._follow(each)
        return state

    def _follow(self, finding: Finding) -> None:
        """Act on a safety rule that fired.

        Raises:
            RigUnresponsive: it asks for an emergency stop, which is sent.
        """
        self._findings.append(finding)
        rule = finding.rule
        if rule.action is Action.HOLD:
            self._log.event(rule.event, finding.value)
            return
        reason = StopReason(finding.sentence, rule.event, finding.value)
        if rule.action is Action.STOP:
            self._log.note(rule.event, finding.value)
            self._end.stop_at_once(reason)
        self._end.request(reason)

    def _send(self, output: TickOutput) -> int:
        """Command the rig; the sequence number of the command."""
        if output.demand is None:
            self._log.event(Event.DIVERGED, output.after.z)
            asked = f"{output.asked.omega:.4g} rad/s and {output.asked.vx:.4g} m/s"
            raise RigUnresponsive(f"the simulation asks for {asked}, which the limits refuse")
        return self._link.send(Drive(*output.demand, self._tick.driven, self._valid_ms))

    def _handle_overrun(self, late: float, skipped: int) -> None:
        self._statistics.add_overrun(skipped)
        self._log.event(Event.OVERRUN, late)
        if skipped:
            self._log.event(Event.TICKS_SKIPPED, skipped)
        if self._overruns is Overruns.STOP:
            why = f"a deadline was missed by {late * 1e3:.3g} ms"
            self._end.request(StopReason(why, Event.FAILED, late))

    def _check_readings(self, state: LoopState, output: TickOutput, polled: PolledReading) -> None:
        """Events and the end of the run that follow from a refused reading or a sensor's fault."""
        reading, verdict = polled.reading, output.verdict
        if reading is not None and verdict is not None and verdict is not Verdict.USED:
            self._statistics.refused += 1
            by_x = verdict is Verdict.JUMP_OF_X
            self._log.event(Event.READING_REFUSED, reading.x if by_x else reading.z)
            refused, most = state.watch.refused, self._tick.loop.readings.in_a_row
            if refused >= most:
                why = f"{most} readings in a row were refused, the last as {verdict.value}"
                self._end.request(StopReason(why, Event.READINGS_REFUSED_IN_A_ROW, refused))
        self._sensors.update(state.watch, reading, state.demand.omega)

    def _count(self, times: tuple[float, float], output: TickOutput, polled: PolledReading) -> None:
        driven = self._tick.driven
        self._statistics.fresh += polled.reading is not None
        self._statistics.old += driven and polled.answers_old_command
        self._statistics.add_tick(*times, output.after.error if driven else float("nan"))
