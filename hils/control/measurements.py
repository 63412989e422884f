"""Measurements of the rig: the zero at touch-down, the newest reading, silent and stale rigs."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from hils.control.event_log import EventLog
from hils.control.limits import Reading, ReadingMonitor
from hils.events import Event, TickFlag
from hils.link.link import AbstractLink, Arrival
from hils.link.messages import (
    READY,
    EmergencyStop,
    HelloAck,
    Measurement,
    RigState,
    StateReport,
    reason_in_words,
)

# As plain numbers: an enumeration's own arithmetic takes a microsecond each.
STUCK, DRIVE_OFF, X_STUCK = (int(TickFlag[name]) for name in ["STUCK", "DRIVE_OFF", "X_STUCK"])


class TouchdownZero(NamedTuple):
    """Counts at touch-down, and the scales of the rig.

    Attributes:
        x, z: Counts where the wheel touches the sand.
        x_scale, z_scale: Metres a count; x is not measured where its scale is 0.
    """

    x: float
    z: float
    x_scale: float
    z_scale: float

    def reading(self, measurement: Measurement, time: float) -> Reading:
        """The measurement in metres, arrived at this time of the run [s]."""
        return Reading(
            time,
            (measurement.x - self.x) * self.x_scale if self.x_scale else math.nan,
            (measurement.z - self.z) * self.z_scale,
            measurement.omega,
        )


def measured_channels(x_scale: float) -> tuple[str, ...]:
    """Channels of /measured that a rig with this scale of x [m a count] fills."""
    return ("x", "z") if x_scale else ("z",)


@dataclass(frozen=True)
class ResponseSettings:
    """Patience with a rig whose measurements stay out or come late.

    Attributes:
        silent_time: Time without a measurement, at least, after which the rig is not followed any
            further [s].
        silent_ticks: The same in ticks; the longer of both counts.
        stale_time: Age of a reading, at least, that is worth an event [s]; zeta is not tuned by a
            reading that answers a command as old.
        stale_ticks: The same in ticks; the longer of both counts.
        clock_jump: Difference between the rig's clock and the host's from one reading to the next
            that is worth an event [s]; more than a line can hold a reading back before the rig
            counts as silent.
    """

    silent_time: float = 0.25
    silent_ticks: int = 5
    stale_time: float = 0.03
    stale_ticks: int = 5
    clock_jump: float = 0.5

    def longest_silence(self, period: float) -> float:
        """Time without a measurement after which a run is ended [s], by the control period [s]."""
        return max(self.silent_time, self.silent_ticks * period)

    def stale_age(self, period: float) -> float:
        """Age at which a reading is stale [s], by the control period [s]."""
        return max(self.stale_ticks * period, self.stale_time)


DEFAULT_RESPONSE = ResponseSettings()


class RigUnresponsive(Exception):
    """The rig no longer follows: there is nothing to ramp down."""


class PolledReading(NamedTuple):
    """Newest measurement at a tick.

    Attributes:
        reading: The measurement, where it was not seen before.
        answers_old_command: True of a new reading that answers a command so old that it counts as
            stale. A line that holds all back alike is seen by nothing else.
        age: Of the newest reading [s].
        seq: Sequence number of the newest measurement; 0 before the first.
        rig_time: Clock of the rig, which does not wrap here [s].
    """

    reading: Reading | None
    answers_old_command: bool
    age: float
    seq: int
    rig_time: float


class MeasurementTracker:
    """Newest measurement of the rig on each tick, and its stops and resets.

    Args:
        link: To the rig.
        log: Takes events.
        zero: Counts at touch-down.
        ack: Answer of the rig to HELLO.
        period: Control period [s].
        settings: Patience with a rig whose measurements stay out or come late.
    """

    def __init__(
        self,
        link: AbstractLink,
        log: EventLog,
        zero: TouchdownZero,
        ack: HelloAck,
        period: float,
        settings: ResponseSettings = DEFAULT_RESPONSE,
    ):
        self._link, self._log, self._zero, self._ack = link, log, zero, ack
        self._longest_silence = settings.longest_silence(period)
        self._stale_age = settings.stale_age(period)
        self._clock_jump = settings.clock_jump
        self._start = self._reading_time = 0.0
        self._seen: Arrival | None = None
        self._stale = False
        self._clocked: Arrival | None = None
        self._rig_us = 0

    def begin(self, start: float) -> None:
        """Begin the run at this time [s]; what came before is no reading of it."""
        self._start = start
        self._seen = self._link.newest()
        if self._seen is not None:
            self._follow_rig_clock(self._seen)

    def poll(self, now: float) -> PolledReading:
        """The newest measurement at this time [s].

        Raises:
            RigUnresponsive: the rig is silent, or has stopped by itself.
            LinkLost: it can no longer be reached.
        """
        for report in self._link.reports():
            self._handle_report(report)
        arrival = self._link.newest()
        seen, self._seen = self._seen, arrival
        behind = self._check_age(arrival, now)
        reading = None if arrival is None else self._new_reading(arrival, seen)
        return PolledReading(
            reading,
            reading is not None and behind > self._stale_age,
            max(0.0, now - self._start - self._reading_time),
            0 if arrival is None else arrival.frame.seq,
            self._rig_us * 1e-6,
        )

    def _check_age(self, arrival: Arrival | None, now: float) -> float:
        """Age of the command that the newest measurement answers [s]; a silent rig is refused."""
        silent = now - (self._start if arrival is None else max(arrival.time, self._start))
        behind = now - self._command_time(arrival, now)
        age = max(silent, behind)
        if age > self._stale_age:
            self._check_reset()
            if not self._stale:
                self._log.event(Event.READINGS_STALE, age)
            if silent > self._longest_silence:
                raise RigUnresponsive(f"the rig has sent no measurement for {silent:.2f} s")
        self._stale = age > self._stale_age
        return behind

    def _new_reading(self, arrival: Arrival, seen: Arrival | None) -> Reading | None:
        time = arrival.time - self._start
        if (seen is not None and arrival.frame.seq == seen.frame.seq) or time <= 0:
            return None
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if measurement.fault:
            self._log.note(Event.RIG_FAULT, measurement.fault)
            raise RigUnresponsive(f"the rig reports fault {measurement.fault}")
        self._require_ready(measurement.state)
        self._follow_rig_clock(arrival)
        # Two may arrive at one reading of a coarse clock; a run log's times increase.
        self._reading_time = max(time, math.nextafter(self._reading_time, math.inf))
        return self._zero.reading(measurement, self._reading_time)

    def _follow_rig_clock(self, arrival: Arrival) -> None:
        """Take over the rig's clock, which wraps on the wire; it may be set or restart."""
        before, self._clocked = self._clocked, arrival
        if before is None:
            self._rig_us = arrival.frame.t_us
            return
        # The nearer way round: a clock that goes back is no clock that ran for an hour.
        step = (arrival.frame.t_us - before.frame.t_us + 2**31) % 2**32 - 2**31
        self._rig_us += step
        jump = step * 1e-6 - (arrival.time - before.time)
        if abs(jump) > self._clock_jump:
            self._log.event(Event.RIG_CLOCK_JUMPED, jump)

    def _command_time(self, arrival: Arrival | None, now: float) -> float:
        """Time at which the command that a measurement answers was sent [s]; now if not known."""
        message = None if arrival is None else arrival.frame.message
        sent = self._link.sent_at(message.ack_seq) if isinstance(message, Measurement) else None
        return now if sent is None else sent

    def _handle_report(self, report: Arrival) -> None:
        message = report.frame.message
        if isinstance(message, EmergencyStop):
            self._link.send(message)
            self._log.note(Event.EMERGENCY_STOP, message.reason)
            why = reason_in_words(self._ack.rig_id, message.reason)
            raise RigUnresponsive(f"the rig made an emergency stop, {why}")
        if isinstance(message, StateReport | HelloAck):
            if message.boot_id != self._ack.boot_id:
                self._refuse_reset(message.boot_id)
            reason = message.reason if isinstance(message, StateReport) else None
            self._require_ready(message.state, reason)

    def _require_ready(self, state: RigState, reason: int | None = None) -> None:
        if state not in READY:
            self._log.note(Event.RIG_STATE, state)
            why = "" if reason is None else f", {reason_in_words(self._ack.rig_id, reason)}"
            raise RigUnresponsive(f"the rig went {state.name}{why}")

    def _check_reset(self) -> None:
        foreign = self._link.quality().foreign_state
        if foreign is not None and foreign.boot_id != self._ack.boot_id:
            self._refuse_reset(foreign.boot_id)

    def _refuse_reset(self, boot_id: int) -> None:
        self._log.note(Event.RIG_RESET, boot_id)
        raise RigUnresponsive("the rig was reset")


class SensorFaults:
    """Stuck sensors and a drive that does not follow, as events where they begin and end.

    Args:
        log: Takes events.

    Attributes:
        flags: Those that hold, as bits of `hils.events.TickFlag`.
    """

    def __init__(self, log: EventLog):
        self._log = log
        self._stuck = self._drive_off = self._x_stuck = False
        self.flags = 0

    def update(self, monitor: ReadingMonitor, reading: Reading | None, omega: float) -> None:
        """Take over the faults found on a tick.

        Args:
            monitor: After the tick.
            reading: Of the tick.
            omega: Angular velocity commanded on it [rad/s].
        """
        if monitor.stuck != self._stuck:
            self._stuck = monitor.stuck
            still = monitor.time - monitor.still_since
            self._log.event(Event.SENSOR_STUCK if self._stuck else Event.SENSOR_MOVES_AGAIN, still)
        if monitor.drive_off != self._drive_off:
            self._drive_off = monitor.drive_off
            error = 0.0 if reading is None else reading.omega - omega
            self._log.event(Event.DRIVE_OFF if self._drive_off else Event.DRIVE_FOLLOWS, error)
        if monitor.x_stuck != self._x_stuck:
            self._x_stuck = monitor.x_stuck
            still = monitor.time - monitor.x_still_since
            self._log.event(Event.X_STUCK if self._x_stuck else Event.X_MOVES_AGAIN, still)
        self.flags = STUCK * self._stuck | DRIVE_OFF * self._drive_off | X_STUCK * self._x_stuck
