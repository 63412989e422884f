"""The tick loop: absolute deadlines, the newest reading in, a command out, everything recorded."""

import enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hils.clock import AbstractClock
from hils.control.event_log import EventLog
from hils.control.limits import REST, Reading, RigCommand, Verdict
from hils.control.measurements import (
    MeasurementTracker,
    RigUnresponsive,
    TouchdownZero,
    measured_channels,
)
from hils.control.stop_request import StopReason, StopRequest
from hils.control.tick import AbstractTick, LoopState, TickInput, TickOutput
from hils.events import Event, TickFlag
from hils.link.link import AbstractLink, Arrival
from hils.link.messages import EMERGENCY, Drive, EmergencyStop, HelloAck
from hils.recording.row_stream import OnlineRow
from hils.recording.sinks import RowSink

# A ramp is over where the wheel is commanded to rest and the carriage all but stands [m/s], or
# after so much longer than the wheel takes [s].
STANDING, LONGEST_REST = 2e-3, 2.0


# As plain numbers: an enumeration's own arithmetic takes a microsecond each.
FRESH, REFUSED, STUCK, LATE, SKIPPED = (
    int(TickFlag[name]) for name in ["FRESH", "REFUSED", "STUCK", "LATE", "SKIPPED"]
)


LIMITED, RAMPING, OLD, DRIVE_OFF, X_STUCK = (
    int(TickFlag[name]) for name in ["LIMITED", "RAMPING", "OLD", "DRIVE_OFF", "X_STUCK"]
)


class Overruns(enum.Enum):
    """What follows a missed deadline."""

    SKIP = "skip"  # the ticks missed are simulated with the last command held, and it goes on
    STOP = "stop"


class LoopReport(NamedTuple):
    """How the loop went.

    Attributes:
        reason: Why it ended, "completed" where the profile was run to its end.
        completed: Whether that is so.
        ticks: Ticks made.
        overruns: Deadlines missed, skipped ticks included.
        skipped: Ticks that passed unused.
        fresh: Ticks that had a reading not used before.
        refused: Readings refused.
        old: Readings that answered a command too old to tune by; none where nothing is tuned.
        error: Measured minus simulated sinkage where there was a reading [m].
        busy: From waking to the command being away, each tick [s].
        woken: From the due time of the tick, or of the first one skipped before it, to waking [s].
        last: The simulation at the end.
    """

    reason: str
    completed: bool
    ticks: int
    overruns: int
    skipped: int
    fresh: int
    refused: int
    old: int
    error: NDArray[np.float64]
    busy: NDArray[np.float64]
    woken: NDArray[np.float64]
    last: LoopState


class TickLoop:
    """One run of the loop.

    Args:
        conduct: What is done on each tick.
        link, clock: The rig, and the time that the link's arrivals are told in.
        rows: Takes what is recorded.
        log: Takes events; the run's start is known to it.
        stop: Looked at on each tick.
        zero: Counts at touch-down.
        ack: What the rig said of itself when the session was opened.
        overruns: What follows a missed deadline.
        valid_ms: How long the rig may hold a command [ms].
    """

    def __init__(
        self,
        conduct: AbstractTick,
        link: AbstractLink,
        clock: AbstractClock,
        rows: RowSink,
        log: EventLog,
        stop: StopRequest,
        zero: TouchdownZero,
        ack: HelloAck,
        overruns: Overruns,
        valid_ms: int,
    ):
        self._conduct, self._loop, self._tick = conduct, conduct.loop, conduct.loop.tick
        self._link, self._clock, self._rows, self._stop = link, clock, rows, stop
        self._log, self._listener = log, MeasurementTracker(link, log, zero, ack, self._tick)
        self._channels = measured_channels(zero.x_scale)
        self._policy, self._valid_ms = overruns, valid_ms
        # Room for the whole profile and the longest ramp: nothing grows while the loop runs.
        ramp = self._loop.commands.omega / self._loop.ramp + LONGEST_REST
        room = conduct.ticks + math.ceil(ramp / self._tick) + 2
        self._busy, self._woken, self._error = np.zeros(room), np.zeros(room), np.zeros(room)
        self._ticks = self._fresh = self._refused = self._missed = self._skipped = self._old = 0
        self._compared = 0
        self._wish: StopReason | None = None
        self._ramping_since: int | None = None
        self._drops = 0
        self._stuck = self._drive_off = self._x_stuck = False
        self._start = 0.0

    def run(self, state: LoopState, start: float) -> LoopReport:
        """Run the profile from `start` on, in the clock's time [s].

        Raises:
            LinkLost: the rig can no longer be reached.
        """
        self._start = start
        self._listener.begin(start)
        self._drops = self._link.quality().dropped
        self._command(0.0, REST)
        self._rows.event(0.0, Event.STARTED, state.packed[1])
        try:
            while not self._finished(state):
                state = self._one(state)
        except RigUnresponsive as over:
            return self._report(state, str(over), False)
        self._clock.sleep_until(start + state.number * self._tick)
        reason = "completed" if self._wish is None else self._wish.reason
        self._log.event(Event.PROFILE_ENDED if self._wish is None else Event.RAMPED_DOWN)
        return self._report(state, reason, self._wish is None)

    # One tick -----------------------------------------------------------------------------------

    def _one(self, state: LoopState) -> LoopState:
        clock, tick, start = self._clock, self._tick, self._start
        due = start + state.number * tick
        clock.sleep_until(due)
        woken = clock.now()
        number = state.number
        while woken >= start + (number + 1) * tick:
            number += 1
        skipped = number - state.number
        if skipped:
            self._overrun(woken - (due + tick), skipped)
        self._look_at_requests()
        arrival, reading = self._listener.poll(woken)
        ramping = self._ramps(number)

        given = TickInput(
            reading, skipped, ramping, reading is not None and self._listener.answers_old_command
        )
        state, said = self._conduct.step(state, given)
        if said.demand is None:
            self._log.event(Event.DIVERGED, said.after.z)
            asked = f"{said.asked.omega:.4g} rad/s and {said.asked.vx:.4g} m/s"
            raise RigUnresponsive(f"the simulation asks for {asked}, which the limits refuse")
        seq = self._link.send(Drive(*said.demand, self._conduct.driven, self._valid_ms))
        sent = clock.now()
        over = sent - (start + (number + 1) * tick)
        if over > 0.0:
            self._overrun(over, 0)
        # A tick that was skipped had its deadline too.
        late = max(0.0, sent - (due + tick) if skipped else over)
        self._record(said, reading, arrival, woken, late, seq, skipped, ramping)
        self._look_at_readings(state, said, reading)
        if self._ticks < len(self._busy):
            self._busy[self._ticks] = sent - woken
            self._woken[self._ticks] = woken - due
        self._ticks += 1
        return state

    def _record(
        self,
        said: TickOutput,
        reading: Reading | None,
        arrival: Arrival | None,
        woken: float,
        late: float,
        seq: int,
        skipped: int,
        ramping: bool,
    ) -> None:
        rows, tick = self._rows, self._tick
        time = said.number * tick
        assert said.demand is not None
        if skipped:
            self._command(time, said.held)
        self._command((said.number + 1) * tick, said.demand)
        if reading is not None:
            rows.measured(reading.time, *(getattr(reading, name) for name in self._channels))
            self._fresh += 1
        if said.limited:
            rows.event(time, Event.COMMAND_LIMITED, said.asked.vx)
        if not self._conduct.driven:
            return
        refused = reading is not None and said.verdict is not Verdict.USED
        old = reading is not None and self._listener.answers_old_command
        self._old += old
        before = said.before
        rows.online(
            OnlineRow(
                time,
                said.after.zeta,
                before.x,
                before.z,
                before.vx,
                before.fx,
                before.fz,
                int(said.tuned),
                late,
                max(0.0, woken - self._start - self._listener.reading_time),
                FRESH * (reading is not None)
                | REFUSED * refused
                | STUCK * self._stuck
                | LATE * (late > 0)
                | SKIPPED * (skipped > 0)
                | LIMITED * said.limited
                | RAMPING * ramping
                | OLD * old
                | DRIVE_OFF * self._drive_off
                | X_STUCK * self._x_stuck,
                seq,
                0 if arrival is None else arrival.frame.seq,
                (self._listener.rig_us or 0) * 1e-6,
            )
        )
        if not math.isnan(said.after.error) and self._compared < len(self._error):
            self._error[self._compared] = said.after.error
            self._compared += 1

    def _command(self, time: float, demand: RigCommand) -> None:
        if self._conduct.driven:
            self._rows.command(time, demand.omega, demand.vx)
        else:
            self._rows.command(time, demand.omega)

    def _look_at_readings(
        self, state: LoopState, said: TickOutput, reading: Reading | None
    ) -> None:
        """Events and ends that follow from what the guard found."""
        if reading is not None and said.verdict is not Verdict.USED:
            self._refused += 1
            by_x = said.verdict is Verdict.JUMP_OF_X
            self._log.event(Event.READING_REFUSED, reading.x if by_x else reading.z)
            most = self._loop.readings.in_a_row
            if state.watch.refused >= most and self._wish is None:
                why = "" if said.verdict is None else f", the last as {said.verdict.value}"
                wish = f"{most} readings in a row were refused{why}"
                self._end(StopReason(wish, Event.READINGS_REFUSED_IN_A_ROW, state.watch.refused))
        if state.watch.stuck != self._stuck:
            self._stuck = state.watch.stuck
            still = state.watch.time - state.watch.still_since
            self._log.event(Event.SENSOR_STUCK if self._stuck else Event.SENSOR_MOVES_AGAIN, still)
        if state.watch.drive_off != self._drive_off:
            self._drive_off = state.watch.drive_off
            apart = 0.0 if reading is None else reading.omega - state.demand.omega
            self._log.event(Event.DRIVE_OFF if self._drive_off else Event.DRIVE_FOLLOWS, apart)
        if state.watch.x_stuck != self._x_stuck:
            self._x_stuck = state.watch.x_stuck
            still = state.watch.time - state.watch.x_still_since
            self._log.event(Event.X_STUCK if self._x_stuck else Event.X_MOVES_AGAIN, still)

    # Ends ---------------------------------------------------------------------------------------

    def _look_at_requests(self) -> None:
        wish = self._stop.first_reason
        if self._stop.emergency:
            self._link.send(EmergencyStop(EMERGENCY))
            self._log.note(Event.EMERGENCY_STOP, 0.0 if wish is None else wish.arg)
            raise RigUnresponsive(self._stop.reason)
        if self._wish is not None:
            return
        if wish is not None and self._ramping_since is not None:
            self._log.note(wish.event, wish.arg)  # the profile is at its end: it ramps already
        elif wish is not None:
            self._end(wish)
        if self._wish is None and not self._rows.alive:
            self._end(StopReason(f"the recorder {self._rows.reason}", Event.FAILED))

    def _end(self, wish: StopReason) -> None:
        """From the next tick on, ramp down."""
        self._wish = wish
        self._log.note(wish.event, wish.arg)

    def _ramps(self, number: int) -> bool:
        if self._ramping_since is None and (
            self._wish is not None or number >= self._conduct.ticks
        ):
            self._ramping_since = number
        return self._ramping_since is not None

    def _finished(self, state: LoopState) -> bool:
        at_end = state.number >= self._conduct.ticks
        if not at_end and self._ramping_since is None:
            return False
        if state.demand.omega != REST.omega:
            return False
        since = state.number if self._ramping_since is None else self._ramping_since
        resting = (state.number - since) * self._tick
        ramp = self._loop.commands.omega / self._loop.ramp
        return abs(state.demand.vx) < STANDING or resting > ramp + LONGEST_REST

    def _overrun(self, late: float, skipped: int) -> None:
        self._missed += max(skipped, 1)
        self._skipped += skipped
        self._log.event(Event.OVERRUN, late)
        if skipped:
            self._log.event(Event.TICKS_SKIPPED, skipped)
        if self._policy is Overruns.STOP and self._wish is None:
            self._end(
                StopReason(f"a deadline was missed by {late * 1e3:.3g} ms", Event.FAILED, late)
            )

    def _report(self, state: LoopState, reason: str, completed: bool) -> LoopReport:
        dropped = self._link.quality().dropped - self._drops
        if dropped:
            self._log.event(Event.FRAMES_DROPPED, dropped)
        ticks = min(self._ticks, len(self._busy))
        return LoopReport(
            reason,
            completed,
            self._ticks,
            self._missed,
            self._skipped,
            self._fresh,
            self._refused,
            self._old,
            self._error[: self._compared].copy(),
            self._busy[:ticks].copy(),
            self._woken[:ticks].copy(),
            state,
        )
