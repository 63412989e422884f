"""The rig brought to rest, and seen to rest.

    STOP, with commands at rest while the wheel still turns -> seen to rest, or else ESTOP -> BYE

A rig rests where newer measurements than the order say that the wheel turns no more, that the
carriage stands, and that it is not RUNNING. What it does by itself meanwhile is in the log.
"""

import math

from hils.clock import AbstractClock
from hils.control.event_log import EventLog
from hils.control.measurements import longest_silence
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

# A wheel that turns slower rests [rad/s].
RESTING = 0.02


# A carriage stands where it has moved by no more than this [m] in this time [s].
STANDING, STANDING_TIME = 1e-3, 0.2


# After STOP the rig must rest within this time, or twice that of the longest ramp [s]; after an
# emergency stop, within this time and that of the longest ramp.
LONGEST_STOP, LONGEST_EMERGENCY_STOP = 5.0, 1.0


# STOP is not answered by every rig, so it is said again until the wheel rests, so far apart [s].
STOP_INTERVAL = 0.05


class Shutdown:
    """Brings a rig to rest, whatever state it is in.

    Args:
        session, link, clock: The rig.
        ack: What it said of itself when the session was opened.
        stop: Looked at all the while, and asked by the rig's own emergency stop.
        log: Takes what happens meanwhile.
        hold: The command to stand.
        tick: Time from one command to the next [s].
        ramp: Time in which the fastest wheel is ramped down [s]; one whose angular velocity is not
            measured rests no sooner.
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
    ):
        self._session, self._link, self._clock, self._stop = session, link, clock, stop
        self._ack, self._hold, self._tick, self._ramp = ack, hold, tick, ramp
        self._log = log
        self._said: int | None = None

    def bring_to_rest(self) -> bool:
        """STOP; where the rig is not seen to rest, or its stop is urgent, ESTOP; BYE in any case.

        Returns:
            Whether it was seen to rest.

        Raises:
            LinkLost: it can no longer be reached; its watchdog brings it to rest.
        """
        rested = False
        try:
            rested = self._by_stop()
        finally:
            try:
                if self._stop.emergency or not rested:
                    rested = self._by_emergency_stop()
            finally:
                self._say_goodbye()
        return rested

    def _by_stop(self) -> bool:
        began = stop_at = command_at = self._clock.now()
        deadline = began + max(LONGEST_STOP, 2 * self._ramp)
        watch = self._watch_from(began)
        while (now := self._clock.now()) < deadline and not self._stop.emergency:
            if now >= stop_at:
                self._session.stop()
                stop_at = now + STOP_INTERVAL
            if now >= command_at:
                # Commands keep the watchdog quiet while a rig that is heard ramps down. A firmware
                # may be RUNNING by any command, so none goes to a wheel that stands.
                if not watch.stands and self._heard_lately(now):
                    self._link.send(self._hold)
                command_at = now + self._tick
            self._link.wait(min(deadline, stop_at, command_at))
            self._note_wish()
            if self._stopped_by_itself():
                return False
            if watch.rests():
                return True
        return False

    def _by_emergency_stop(self) -> bool:
        began = self._clock.now()
        watch = self._watch_from(began)
        self._note_wish()
        self._said = EMERGENCY if self._stop.emergency else NOT_RESTED
        if not self._session.emergency_stop(self._said):
            return False
        deadline = began + self._ramp + LONGEST_EMERGENCY_STOP
        while self._clock.now() < deadline:
            if watch.rests():
                return True
            self._link.wait(deadline)
        return False

    def _say_goodbye(self) -> None:
        self._session.bye()
        self._note_wish()
        halted = self._session.rig_stop
        # One of the same reason is the rig's answer.
        if halted is None or halted.reason == self._said or self._is_noted(halted):
            return
        self._halt(halted)
        self._link.send(halted)

    def _watch_from(self, began: float) -> "_Watch":
        return _Watch(self._link, began, self._ramp, abs(self._ack.x_scale))

    def _heard_lately(self, now: float) -> bool:
        arrival = self._link.newest()
        return arrival is not None and now - arrival.time < longest_silence(self._tick)

    # What happens meanwhile -----------------------------------------------------------------------

    def _stopped_by_itself(self) -> bool:
        """Whether it was reset, so that it answers no STOP, or wants its own ESTOP answered."""
        stranger = self._link.quality().foreign_state
        if stranger is not None and self._was_reset(stranger):
            return True
        for each in self._link.reports():
            message = each.frame.message
            if isinstance(message, EmergencyStop):
                self._halt(message)
                return True
            if isinstance(message, StateReport | HelloAck):
                if self._was_reset(message):
                    return True
                self._heed(message.state)
        newest = self._link.newest()
        if newest is not None:
            measurement = newest.frame.message
            assert isinstance(measurement, Measurement)
            self._heed(measurement.state, measurement.fault)
        return False

    def _was_reset(self, said: StateReport | HelloAck) -> bool:
        if said.boot_id == self._ack.boot_id:
            return False
        self._log.note(Event.RIG_RESET, said.boot_id)
        return True

    def _halt(self, message: EmergencyStop) -> None:
        """Whoever pressed the rig's button wants no further run either."""
        self._log.note(Event.EMERGENCY_STOP, message.reason)
        why = f"the rig made an emergency stop, {reason_in_words(self._ack.rig_id, message.reason)}"
        self._stop.ask(StopReason(why, Event.EMERGENCY_STOP, message.reason))

    def _heed(self, state: RigState, fault: int = 0) -> None:
        if state in STOPPED and not self._log.has_noted(Event.EMERGENCY_STOP):
            self._log.note(Event.RIG_STATE, state)
        if fault:
            self._log.note(Event.RIG_FAULT, fault)
        if self._stop.first_reason is None and (fault or state is RigState.FAULT):
            why = f"the rig reports fault {fault}" if fault else "the rig went FAULT"
            event, arg = (Event.RIG_FAULT, fault) if fault else (Event.RIG_STATE, state)
            self._stop.ask(StopReason(why, event, arg))

    def _note_wish(self) -> None:
        wish = self._stop.first_reason
        if wish is None:
            return
        self._log.note(wish.event, wish.arg)
        if self._stop.emergency and not self._log.has_noted(Event.EMERGENCY_STOP):
            self._log.note(Event.EMERGENCY_STOP, wish.arg)

    def _is_noted(self, halted: EmergencyStop) -> bool:
        return self._log.has_noted(Event.EMERGENCY_STOP, halted.reason)


class _Watch:
    """What the rig's measurements say of its motion.

    Args:
        link: To the rig.
        began: Only newer measurements count [s].
        ramp: Time in which the wheel has ramped down, where its turning is not measured [s].
        scale: Of x, 0 where that is not measured [m a count].

    Attributes:
        stands: Whether wheel and carriage stood at the last look.
    """

    def __init__(self, link: AbstractLink, began: float, ramp: float, scale: float):
        self._link, self._began, self._ramped, self._scale = link, began, began + ramp, scale
        self._place, self._since = math.nan, math.inf
        self.stands = False

    def rests(self) -> bool:
        """Whether the newest measurement shows a rig at rest."""
        arrival = self._link.newest()
        if arrival is None or arrival.time <= self._began:
            return False
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if not abs(measurement.x - self._place) * self._scale <= STANDING:
            self._place, self._since = measurement.x, arrival.time
        turns_not = abs(measurement.omega) <= RESTING
        if math.isnan(measurement.omega):
            turns_not = arrival.time >= self._ramped
        self.stands = turns_not and arrival.time - self._since >= STANDING_TIME
        return self.stands and measurement.state is not RigState.RUNNING
