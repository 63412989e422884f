"""Measurements of the rig: the zero at touch-down, the newest reading, silent and stale rigs."""

import math
from dataclasses import dataclass
from typing import NamedTuple

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
from hils.recording.event_log import EventLog

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


def measured_channels(x_scale: float, omega: bool) -> tuple[str, ...]:
    """Channels of /measured that a rig fills.

    Args:
        x_scale: Metres a count of x; 0 where it is not measured.
        omega: True where the rig measures its wheel's speed.
    """
    every = (("x", bool(x_scale)), ("z", True), ("omega", omega))
    return tuple(name for name, there in every if there)


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
        clock_window: Time over which the least delay of a reading is looked for, which tells the
            rig's clock from the host's [s]; short, so that a rig's clock may be slow by a tenth, as
            a virtual rig's on a busy computer, and its readings do not count as old.
        clock_step: Change of that delay from one reading to the next that is the clock's [s]; a
            line that holds a reading back for longer is a silent one.
        clock_jump: Difference between the rig's clock and the host's from one reading to the next
            that is worth an event [s].
    """

    silent_time: float = 0.25
    silent_ticks: int = 5
    stale_time: float = 0.03
    stale_ticks: int = 5
    clock_window: float = 0.5
    clock_step: float = 0.25
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
        age: Of the newest reading, from its sample on, as far as the rig's clock tells [s].
        behind: Age of the command that the newest measurement answers [s].
        seq: Sequence number of the newest measurement; 0 before the first.
        ack_seq: Of the command that it answers.
        rig_time: Clock of the rig, which does not wrap here [s].
        state, fault: Of the rig, as the newest measurement says.
    """

    reading: Reading | None
    answers_old_command: bool
    age: float
    behind: float
    seq: int
    ack_seq: int
    rig_time: float
    state: int
    fault: int


class SampleClock:
    """Age of samples by the rig's clock, which runs beside the host's.

    The least delay between sample and arrival over the last moments is taken for that of the line,
    half of the round trip; what a reading is later than that, it is older.

    Args:
        settings: Window and jumps.
    """

    def __init__(self, settings: ResponseSettings):
        self._settings = settings
        self._begin, self._first = -math.inf, math.nan
        self._last = self._least = self._before = math.inf
        self._trip = math.inf

    def age(self, arrival: float, sampled: float, trip: float) -> float:
        """Age of a sample when it arrived [s].

        Args:
            arrival: By the host's clock [s].
            sampled: By the rig's [s].
            trip: From the command that it answers being sent to the arrival [s].
        """
        delay, settings = arrival - sampled, self._settings
        self._trip = min(self._trip, trip) if trip > 0 else self._trip
        line = self._trip / 2 if math.isfinite(self._trip) else 0.0
        if math.isnan(self._first):
            self._first = sampled
        if sampled == self._first:  # a clock that has not moved yet may be none
            return line
        if abs(delay - self._last) > settings.clock_step and math.isfinite(self._last):
            self._least = self._before = math.inf  # the rig's clock was set
        if arrival - self._begin > settings.clock_window:
            self._before, self._least, self._begin = self._least, math.inf, arrival
        self._last, self._least = delay, min(self._least, delay)
        return delay - min(self._least, self._before) + line


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
        self._start = self._reading_time = self._age = 0.0
        self._samples = SampleClock(settings)
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
        if arrival is None:
            return PolledReading(None, False, now - self._start, behind, 0, 0, 0.0, 0, 0)
        reading = self._new_reading(arrival, seen)
        message = arrival.frame.message
        assert isinstance(message, Measurement)
        if reading is not None:
            sent = self._link.sent_at(message.ack_seq)
            trip = 0.0 if sent is None else arrival.time - sent
            self._age = self._samples.age(arrival.time, self._rig_time, trip)
        age = max(0.0, now - max(arrival.time, self._start)) + self._age
        self._require_recent(max(age, behind))
        return PolledReading(
            reading,
            reading is not None and behind > self._stale_age,
            age,
            behind,
            arrival.frame.seq,
            message.ack_seq,
            self._rig_time,
            int(message.state),
            message.fault,
        )

    @property
    def _rig_time(self) -> float:
        return self._rig_us * 1e-6

    def _require_recent(self, age: float) -> None:
        if age > self._longest_silence:
            self._log.note(Event.READINGS_TOO_OLD, age)
            raise RigUnresponsive(
                f"the rig's newest reading is {age:.2f} s old, {self._longest_silence:.2g} s are "
                "allowed: something holds the line's bytes back, or the rig reads its sensors late"
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
        sentences: Words on each kind of stuck sensor that was there.
    """

    def __init__(self, log: EventLog):
        self._log = log
        self._held = dict.fromkeys((STUCK, DRIVE_OFF, X_STUCK), False)
        self.flags = 0
        self.sentences: list[str] = []

    def update(self, monitor: ReadingMonitor, reading: Reading | None, omega: float) -> None:
        """Take over the faults found on a tick.

        Args:
            monitor: After the tick.
            reading: Of the tick.
            omega: Angular velocity commanded on it [rad/s].
        """
        z_since, x_since = monitor.still_since, monitor.x_still_since
        if self._changes(STUCK, monitor.stuck):
            since = monitor.time - z_since
            self._log.event(
                Event.SENSOR_STUCK if monitor.stuck else Event.SENSOR_MOVES_AGAIN, since
            )
            self._say(monitor.stuck, "z did not change while the wheel turned", z_since)
        if self._changes(DRIVE_OFF, monitor.drive_off):
            error = 0.0 if reading is None else reading.omega - omega
            self._log.event(Event.DRIVE_OFF if monitor.drive_off else Event.DRIVE_FOLLOWS, error)
        if self._changes(X_STUCK, monitor.x_stuck):
            since = monitor.time - x_since
            self._log.event(Event.X_STUCK if monitor.x_stuck else Event.X_MOVES_AGAIN, since)
            self._say(monitor.x_stuck, "x did not change while the carriage was driven", x_since)
        self.flags = sum(bit for bit, holds in self._held.items() if holds)

    def _changes(self, bit: int, holds: bool) -> bool:
        before, self._held[bit] = self._held[bit], holds
        return holds != before

    def _say(self, begins: bool, seen: str, since: float) -> None:
        """Keep a sentence on the first fault of a kind."""
        if begins and not any(each.startswith(seen) for each in self.sentences):
            self.sentences.append(f"{seen}, from {since:.2f} s on")
