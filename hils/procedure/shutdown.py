"""Shutdown of the rig: brought to rest, and measured to rest.

    STOP, with commands at rest while the wheel still turns -> seen to rest, or else ESTOP -> BYE

A rig rests where measurements newer than the order say that the wheel no longer turns, that the
carriage stands, and that it is not RUNNING. Its own stops, faults and resets meanwhile are logged.
"""

import math
from dataclasses import dataclass

from hils.clock import AbstractClock
from hils.control.measurements import DEFAULT_RESPONSE, ResponseSettings
from hils.control.safety import DEFAULT_SAFETY, SafetySettings
from hils.control.stop_request import StopReason, StopRequest
from hils.events import Event
from hils.link.link import AbstractLink
from hils.link.messages import (
    EMERGENCY,
    NOT_RESTED,
    Drive,
    EmergencyStop,
    HelloAck,
    Measurement,
    RigState,
    StateReport,
    reason_in_words,
)
from hils.procedure.session import STOPPED, Session
from hils.recording.event_log import EventLog


@dataclass(frozen=True)
class ShutdownSettings:
    """Signs of a rig at rest, and the time that it is given.

    Attributes:
        max_omega: Angular velocity under which the wheel rests [rad/s].
        max_travel: Travel within `standing_time` under which the carriage stands [m].
        standing_time: Time over which it has stood [s].
        longest_stop: Time after STOP, or twice that of the longest ramp if that is longer, after
            which an emergency stop follows [s].
        longest_emergency_stop: Time after an emergency stop, on top of that of the longest ramp,
            after which the rig counts as not seen to rest [s].
        stop_interval: From one STOP to the next [s]; not every rig answers it, so it is repeated
            until the wheel rests.
    """

    max_omega: float = 0.02
    max_travel: float = 1e-3
    standing_time: float = 0.2
    longest_stop: float = 5.0
    longest_emergency_stop: float = 1.0
    stop_interval: float = 0.05


DEFAULT_SHUTDOWN = ShutdownSettings()


class Shutdown:
    """Brings a rig to rest, whatever state it is in.

    Args:
        session, link, clock: The rig.
        ack: Answer of the rig to HELLO.
        stop: Requests, checked all the while; an emergency stop of the rig's own makes one.
        log: Takes events.
        hold: The command to stand.
        tick: Time from one command to the next [s].
        ramp: Time in which the fastest wheel is ramped down [s]; one whose angular velocity is not
            measured rests no sooner.
        settings: Signs of rest, and deadlines.
        response: Patience with a silent rig.
        safety: Numbers of the safety rules.

    Attributes:
        findings: Sentences on a wheel that did not slow down.
    """

    def __init__(
        self,
        session: Session,
        link: AbstractLink,
        clock: AbstractClock,
        ack: HelloAck,
        stop: StopRequest,
        log: EventLog,
        hold: Drive,
        tick: float,
        ramp: float,
        settings: ShutdownSettings = DEFAULT_SHUTDOWN,
        response: ResponseSettings = DEFAULT_RESPONSE,
        safety: SafetySettings = DEFAULT_SAFETY,
    ):
        self.findings: tuple[str, ...] = ()
        self._safety = safety
        self._session, self._link, self._clock, self._stop = session, link, clock, stop
        self._ack, self._hold_command, self._tick, self._ramp = ack, hold, tick, ramp
        self._log, self._settings = log, settings
        self._longest_silence = response.longest_silence(tick)
        self._sent_reason: int | None = None

    def bring_to_rest(self) -> bool:
        """Send STOP; where the rig is not seen to rest, or its stop is urgent, ESTOP; BYE in any
        case (docs/reference/wire.md).

        Returns:
            True where it was seen to rest.

        Raises:
            LinkLost: it can no longer be reached; its watchdog brings it to rest.
        """
        rested = False
        try:
            rested = self._stop_by_ramp()
        finally:
            try:
                if self._stop.emergency or not rested:
                    rested = self._stop_at_once()
            finally:
                self._end_session()
        return rested

    def _stop_by_ramp(self) -> bool:
        began = stop_at = command_at = self._clock.now()
        deadline = began + max(self._settings.longest_stop, 2 * self._ramp)
        watch = self._detector_from(began)
        slowing = _SlowingDetector(self._link, began, self._safety)
        while (now := self._clock.now()) < deadline and not self._stop.emergency:
            if now >= stop_at:
                self._session.stop()
                stop_at = now + self._settings.stop_interval
            if now >= command_at:
                # Commands keep the watchdog quiet while a rig that is heard ramps down. A firmware
                # may be RUNNING by any command, so none goes to a wheel that stands.
                if not watch.is_standing and self._is_responding(now):
                    self._link.send(self._hold_command)
                command_at = now + self._tick
            self._link.wait(min(deadline, stop_at, command_at))
            self._note_request()
            if self._has_stopped_itself():
                return False
            if watch.is_at_rest():
                return True
            if (omega := slowing.unslowed()) is not None:
                self._log.note(Event.NOT_SLOWING, omega)
                self.findings = (f"after STOP the wheel went on turning, at {omega:.3g} rad/s",)
                return False
        return False

    def _stop_at_once(self) -> bool:
        began = self._clock.now()
        watch = self._detector_from(began)
        self._note_request()
        self._sent_reason = EMERGENCY if self._stop.emergency else NOT_RESTED
        if not self._session.emergency_stop(self._sent_reason):
            return False
        deadline = began + self._ramp + self._settings.longest_emergency_stop
        while self._clock.now() < deadline:
            if watch.is_at_rest():
                return True
            self._link.wait(deadline)
        return False

    def _end_session(self) -> None:
        self._session.bye()
        self._note_request()
        rig_stop = self._session.rig_stop
        # One of the same reason is the rig's answer.
        if rig_stop is None or rig_stop.reason == self._sent_reason or self._is_logged(rig_stop):
            return
        self._note_rig_stop(rig_stop)
        self._link.send(rig_stop)

    def _detector_from(self, began: float) -> "_RestDetector":
        scale = abs(self._ack.x_scale)
        return _RestDetector(self._link, began, self._ramp, scale, self._settings)

    def _is_responding(self, now: float) -> bool:
        arrival = self._link.newest()
        return arrival is not None and now - arrival.time < self._longest_silence

    # What happens meanwhile -----------------------------------------------------------------------

    def _has_stopped_itself(self) -> bool:
        """True where it was reset, so that it answers no STOP, or wants its own ESTOP answered."""
        foreign = self._link.quality().foreign_state
        if foreign is not None and self._note_reset(foreign):
            return True
        for each in self._link.reports():
            message = each.frame.message
            if isinstance(message, EmergencyStop):
                self._note_rig_stop(message)
                return True
            if isinstance(message, StateReport | HelloAck):
                if self._note_reset(message):
                    return True
                self._note_state(message.state)
        newest = self._link.newest()
        if newest is not None:
            measurement = newest.frame.message
            assert isinstance(measurement, Measurement)
            self._note_state(measurement.state, measurement.fault)
        return False

    def _note_reset(self, message: StateReport | HelloAck) -> bool:
        if message.boot_id == self._ack.boot_id:
            return False
        self._log.note(Event.RIG_RESET, message.boot_id)
        return True

    def _note_rig_stop(self, message: EmergencyStop) -> None:
        """Log the rig's own emergency stop; whoever pressed its button wants no further run."""
        self._log.note(Event.EMERGENCY_STOP, message.reason)
        why = f"the rig made an emergency stop, {reason_in_words(self._ack.rig_id, message.reason)}"
        self._stop.ask(StopReason(why, Event.EMERGENCY_STOP, message.reason))

    def _note_state(self, state: RigState, fault: int = 0) -> None:
        if state in STOPPED and not self._log.has_noted(Event.EMERGENCY_STOP):
            self._log.note(Event.RIG_STATE, state)
        if fault:
            self._log.note(Event.RIG_FAULT, fault)
        if self._stop.first_reason is None and (fault or state is RigState.FAULT):
            why = f"the rig reports fault {fault}" if fault else "the rig went FAULT"
            event, arg = (Event.RIG_FAULT, fault) if fault else (Event.RIG_STATE, state)
            self._stop.ask(StopReason(why, event, arg))

    def _note_request(self) -> None:
        request = self._stop.first_reason
        if request is None:
            return
        self._log.note(request.event, request.arg)
        if self._stop.emergency and not self._log.has_noted(Event.EMERGENCY_STOP):
            self._log.note(Event.EMERGENCY_STOP, request.arg)

    def _is_logged(self, rig_stop: EmergencyStop) -> bool:
        return self._log.has_noted(Event.EMERGENCY_STOP, rig_stop.reason)


class _SlowingDetector:
    """Looks whether a wheel that is commanded to stop slows down.

    Args:
        link: To the rig.
        began: Only newer measurements count [s].
        settings: Numbers of the rule.
    """

    def __init__(self, link: AbstractLink, began: float, settings: SafetySettings):
        self._link, self._began, self._settings = link, began, settings
        self._time, self._omega = math.nan, math.nan

    def unslowed(self) -> float | None:
        """Angular velocity of a wheel that has not slowed down [rad/s]; None of any other."""
        arrival, settings = self._link.newest(), self._settings
        if arrival is None or arrival.time <= self._began:
            return None
        if arrival.time < self._time + settings.slowing_time:
            return None
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        omega, before = measurement.omega, self._omega
        self._time, self._omega = arrival.time, abs(omega)
        unslowed = abs(omega) > before * (1 - settings.slowing_share)  # False for NaN
        return omega if unslowed and abs(omega) > settings.rest_omega else None


class _RestDetector:
    """Rest of a rig, by its measurements.

    Args:
        link: To the rig.
        began: Only newer measurements count [s].
        ramp: Time in which the wheel has ramped down, where its turning is not measured [s].
        scale: Of x, 0 where that is not measured [m a count].
        settings: Signs of rest.

    Attributes:
        is_standing: True where wheel and carriage stood at the last call of `is_at_rest`.
    """

    def __init__(
        self,
        link: AbstractLink,
        began: float,
        ramp: float,
        scale: float,
        settings: ShutdownSettings,
    ):
        self._link, self._began, self._ramped, self._scale = link, began, began + ramp, scale
        self._settings, self._travel, self._since = settings, math.nan, math.inf
        self.is_standing = False

    def is_at_rest(self) -> bool:
        """Return True where the newest measurement shows a rig at rest."""
        arrival = self._link.newest()
        if arrival is None or arrival.time <= self._began:
            return False
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if not abs(measurement.x - self._travel) * self._scale <= self._settings.max_travel:
            self._travel, self._since = measurement.x, arrival.time
        turns_not = abs(measurement.omega) <= self._settings.max_omega
        if math.isnan(measurement.omega):
            turns_not = arrival.time >= self._ramped
        self.is_standing = turns_not and arrival.time - self._since >= self._settings.standing_time
        return self.is_standing and measurement.state is not RigState.RUNNING
