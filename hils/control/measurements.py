"""Measurements of the rig: the zero at touch-down, the newest reading, silent and stale rigs."""

import math
from typing import NamedTuple

from hils.control.event_log import EventLog
from hils.control.limits import Reading
from hils.events import Event
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


class TouchdownZero(NamedTuple):
    """Counts at touch-down, and what a count is worth.

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
    """What of /measured a rig with this scale of x gives."""
    return ("x", "z") if x_scale else ("z",)


# A rig that says nothing for so long [s], and for so many ticks, is not followed any further.
SILENCE, SILENT_TICKS = 0.25, 5


# A reading older than so many ticks, and than so long [s], is worth an event.
STALE_TICKS, STALE_TIME = 5, 0.03


class RigUnresponsive(Exception):
    """The rig no longer follows: nothing is left to ramp."""


def longest_silence(tick: float) -> float:
    """Time [s] without a measurement after which a run is ended."""
    return max(SILENCE, SILENT_TICKS * tick)


class MeasurementTracker:
    """Hears the rig on each tick.

    Args:
        link: To the rig.
        log: Takes events.
        zero: Counts at touch-down.
        ack: What the rig said of itself when the session was opened.
        tick: Control period [s].

    Attributes:
        reading_time: Of the newest reading [s], since the start.
        rig_us: The rig's own time then [us], which does not wrap; None before it said any.
        old: Whether the last arrival answers a command so old that its reading counts as stale. A
            line that holds all back alike is seen by nothing else.
    """

    def __init__(
        self, link: AbstractLink, log: EventLog, zero: TouchdownZero, ack: HelloAck, tick: float
    ):
        self._link, self._log, self._zero, self._ack = link, log, zero, ack
        self._tick, self._start = tick, 0.0
        self._seen: Arrival | None = None
        self._stale = False
        self.reading_time = 0.0
        self.rig_us: int | None = None
        self.answers_old_command = False

    def begin(self, start: float) -> None:
        """The run starts at this time [s]; what came before is no reading of it."""
        self._start = start
        self._seen = self._link.newest()
        if self._seen is not None:
            self.rig_us = self._seen.frame.t_us

    def poll(self, now: float) -> tuple[Arrival | None, Reading | None]:
        """The newest arrival, and its reading where it was not seen before.

        Raises:
            Over: the rig is silent, or has stopped by itself.
            LinkLost: it can no longer be reached.
        """
        for report in self._link.reports():
            self._heed(report)
        arrival = self._link.newest()
        seen, self._seen = self._seen, arrival
        silent = now - (self._start if arrival is None else max(arrival.time, self._start))
        stale = max(STALE_TICKS * self._tick, STALE_TIME)
        behind = now - self._answered(arrival, now)
        self.answers_old_command = behind > stale
        age = max(silent, behind)
        if age > stale:
            self._look_for_reset()
            if not self._stale:
                self._log.event(Event.READINGS_STALE, age)
            if silent > longest_silence(self._tick):
                raise RigUnresponsive(f"the rig has sent no measurement for {silent:.2f} s")
        self._stale = age > stale
        if arrival is None:
            return None, None
        time = arrival.time - self._start
        if (seen is not None and arrival.frame.seq == seen.frame.seq) or time <= 0:
            return arrival, None
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if measurement.fault:
            self._log.note(Event.RIG_FAULT, measurement.fault)
            raise RigUnresponsive(f"the rig reports fault {measurement.fault}")
        self._require_obeying(measurement.state)
        t_us = arrival.frame.t_us
        self.rig_us = t_us if self.rig_us is None else self.rig_us + (t_us - self.rig_us) % 2**32
        # Two may arrive at one reading of a coarse clock; a run log's times increase.
        self.reading_time = max(time, math.nextafter(self.reading_time, math.inf))
        return arrival, self._zero.reading(measurement, self.reading_time)

    def _answered(self, arrival: Arrival | None, now: float) -> float:
        """When the command that a measurement answers was sent [s]; now where that is not known."""
        message = None if arrival is None else arrival.frame.message
        sent = self._link.sent_at(message.ack_seq) if isinstance(message, Measurement) else None
        return now if sent is None else sent

    def _heed(self, report: Arrival) -> None:
        message = report.frame.message
        if isinstance(message, EmergencyStop):
            self._link.send(message)
            self._log.note(Event.EMERGENCY_STOP, message.reason)
            why = reason_in_words(self._ack.rig_id, message.reason)
            raise RigUnresponsive(f"the rig made an emergency stop, {why}")
        if isinstance(message, StateReport | HelloAck):
            if message.boot_id != self._ack.boot_id:
                self._reset(message.boot_id)
            reason = message.reason if isinstance(message, StateReport) else None
            self._require_obeying(message.state, reason)

    def _require_obeying(self, state: RigState, reason: int | None = None) -> None:
        if state not in READY:
            self._log.note(Event.RIG_STATE, state)
            why = "" if reason is None else f", {reason_in_words(self._ack.rig_id, reason)}"
            raise RigUnresponsive(f"the rig went {state.name}{why}")

    def _look_for_reset(self) -> None:
        stranger = self._link.quality().foreign_state
        if stranger is not None and stranger.boot_id != self._ack.boot_id:
            self._reset(stranger.boot_id)

    def _reset(self, boot_id: int) -> None:
        self._log.note(Event.RIG_RESET, boot_id)
        raise RigUnresponsive("the rig was reset")
