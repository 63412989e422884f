"""The rig brought to rest, and seen to rest.

    STOP, with commands at rest while the wheel still turns -> seen to rest, or else ESTOP -> BYE

A rig rests where newer measurements than the order say that the wheel turns no more, that the
carriage stands, and that it is not RUNNING.
"""

import math

from hils.clock import AbstractClock
from hils.link import AbstractLink, Arrival
from hils.loop import longest_silence
from hils.session import EMERGENCY, NOT_RESTED, Session
from hils.stop_request import StopRequest
from hils.wire import Drive, EmergencyStop, HelloAck, Measurement, RigState

# A wheel that turns slower rests [rad/s].
RESTING = 0.02
# A carriage stands where it has moved by no more than this [m] in this time [s].
STANDING, STANDING_TIME = 1e-3, 0.2
# After STOP the rig must rest within this time, or twice that of the longest ramp [s]; after an
# emergency stop, within this time and that of the longest ramp.
LONGEST_STOP, LONGEST_EMERGENCY_STOP = 5.0, 1.0
# STOP is not answered by every rig, so it is said again until the wheel rests, so far apart [s].
STOP_INTERVAL = 0.05


class Rest:
    """Brings a rig to rest, whatever state it is in.

    Args:
        session, link, clock: The rig.
        ack: What it said of itself when the session was opened.
        stop: Looked at all the while.
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
        hold: Drive,
        tick: float,
        ramp: float,
    ):
        self._session, self._link, self._clock, self._stop = session, link, clock, stop
        self._ack, self._hold, self._tick, self._ramp = ack, hold, tick, ramp

    def bring(self) -> bool:
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
                self._session.bye()
        return rested

    def _by_stop(self) -> bool:
        began = stop_at = command_at = self._clock.now()
        deadline = began + max(LONGEST_STOP, 2 * self._ramp)
        motion, stands = self._motion_since(began), False
        while (now := self._clock.now()) < deadline and not self._stop.emergency:
            if now >= stop_at:
                self._session.stop()
                stop_at = now + STOP_INTERVAL
            if now >= command_at:
                # Commands keep the watchdog quiet while a rig that is heard ramps down. A firmware
                # may be RUNNING by any command, so none goes to a wheel that stands.
                if not stands and self._heard_lately(now):
                    self._link.send(self._hold)
                command_at = now + self._tick
            self._link.wait(min(deadline, stop_at, command_at))
            if self._stopped_by_itself():
                return False
            arrival = self._link.newest()
            if arrival is not None and arrival.time > began:
                stands = motion.over(arrival)
                if stands and _measured(arrival).state is not RigState.RUNNING:
                    return True
        return False

    def _by_emergency_stop(self) -> bool:
        began = self._clock.now()
        motion = self._motion_since(began)
        if not self._session.emergency_stop(EMERGENCY if self._stop.emergency else NOT_RESTED):
            return False
        deadline = began + self._ramp + LONGEST_EMERGENCY_STOP
        while self._clock.now() < deadline:
            arrival = self._link.newest()
            if arrival is not None and arrival.time > began:
                stands = motion.over(arrival)
                if stands and _measured(arrival).state is not RigState.RUNNING:
                    return True
            self._link.wait(deadline)
        return False

    def _motion_since(self, began: float) -> "_Motion":
        return _Motion(began + self._ramp, abs(self._ack.x_scale))

    def _heard_lately(self, now: float) -> bool:
        arrival = self._link.newest()
        return arrival is not None and now - arrival.time < longest_silence(self._tick)

    def _stopped_by_itself(self) -> bool:
        """Whether it was reset, so that it answers no STOP, or wants its own ESTOP answered."""
        stranger = self._link.quality().stranger
        if stranger is not None and stranger.boot_id != self._ack.boot_id:
            return True
        reports = self._link.reports()
        return any(isinstance(each.frame.message, EmergencyStop) for each in reports)


class _Motion:
    """What the rig's measurements say of its motion.

    Args:
        ramped: When the wheel has ramped down, which counts where its turning is not measured [s].
        scale: Of x, 0 where that is not measured [m a count].
    """

    def __init__(self, ramped: float, scale: float):
        self._ramped, self._scale = ramped, scale
        self._place, self._since = math.nan, math.inf

    def over(self, arrival: Arrival) -> bool:
        """Whether nothing moves any more, by a measurement no older than the last."""
        measurement = _measured(arrival)
        if not abs(measurement.x - self._place) * self._scale <= STANDING:
            self._place, self._since = measurement.x, arrival.time
        rests = abs(measurement.omega) <= RESTING
        if math.isnan(measurement.omega):
            rests = arrival.time >= self._ramped
        return rests and arrival.time - self._since >= STANDING_TIME


def _measured(arrival: Arrival) -> Measurement:
    assert isinstance(arrival.frame.message, Measurement)
    return arrival.frame.message
