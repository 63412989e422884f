"""End of a run: requests for it, and the ramp to rest behind the last tick of the profile."""

import math
from dataclasses import dataclass

from hils.control.limits import REST
from hils.control.measurements import RigUnresponsive
from hils.control.stop_request import StopReason, StopRequest
from hils.control.tick import AbstractTick, LoopState
from hils.events import Event
from hils.link.link import AbstractLink
from hils.link.messages import EMERGENCY, EmergencyStop
from hils.recording.event_log import EventLog
from hils.recording.sinks import RowSink


@dataclass(frozen=True)
class RampSettings:
    """End of a ramp to rest.

    Attributes:
        standing_speed: Commanded carriage speed under which the carriage all but stands [m/s].
        extra_time: Time over that of the wheel's ramp after which the ramp is over though the
            carriage is still driven [s].
    """

    standing_speed: float = 2e-3
    extra_time: float = 2.0


DEFAULT_RAMP = RampSettings()


class RunEnd:
    """Requests to end a run, and the ramp that follows one or the end of the profile.

    Args:
        tick: Work of a tick, with the numbers of the loop.
        link: To the rig.
        rows: Sink of the rows; a recorder that is lost ends the run.
        log: Takes events.
        stop: Requests from outside.
        settings: End of the ramp.

    Attributes:
        reason: First request that was followed; None while there is none.
    """

    def __init__(
        self,
        tick: AbstractTick,
        link: AbstractLink,
        rows: RowSink,
        log: EventLog,
        stop: StopRequest,
        settings: RampSettings = DEFAULT_RAMP,
    ):
        self._link, self._rows, self._log, self._stop = link, rows, log, stop
        self._profile_ticks, self._period = tick.ticks, tick.loop.tick
        self._standing_speed = settings.standing_speed
        self._longest_ramp = tick.loop.commands.omega / tick.loop.ramp + settings.extra_time
        self._ramping_since: int | None = None
        self.reason: StopReason | None = None

    @property
    def most_ticks(self) -> int:
        """Ticks of the whole profile and the longest ramp."""
        return self._profile_ticks + math.ceil(self._longest_ramp / self._period) + 2

    def check_requests(self) -> None:
        """Follow a request to stop; a recorder that is lost makes one.

        Raises:
            RigUnresponsive: an emergency stop was requested; it is sent.
        """
        request = self._stop.first_reason
        if self._stop.emergency:
            self._link.send(EmergencyStop(EMERGENCY))
            self._log.note(Event.EMERGENCY_STOP, 0.0 if request is None else request.arg)
            raise RigUnresponsive(self._stop.reason)
        if self.reason is not None:
            return
        if request is not None and self._ramping_since is not None:
            self._log.note(request.event, request.arg)  # past the profile it ramps already
        elif request is not None:
            self.request(request)
        if self.reason is None and not self._rows.alive:
            self.request(StopReason(f"the recorder {self._rows.reason}", Event.FAILED))

    def stop_at_once(self, reason: StopReason) -> None:
        """Make an emergency stop for a reason of the loop's own.

        Raises:
            RigUnresponsive: always, once it is sent.
        """
        self._stop.ask(reason, emergency=True)
        self.check_requests()

    def request(self, reason: StopReason) -> None:
        """Ramp down from the next tick on; only the first request counts."""
        if self.reason is None:
            self.reason = reason
            self._log.note(reason.event, reason.arg)

    def ramps_at(self, number: int) -> bool:
        """Return True where this tick belongs to the ramp, which it may begin."""
        ends = self.reason is not None or number >= self._profile_ticks
        if self._ramping_since is None and ends:
            self._ramping_since = number
        return self._ramping_since is not None

    def is_finished(self, state: LoopState) -> bool:
        """Return True where the ramp is over: the wheel is commanded to rest, and the carriage all
        but stands or has had its time."""
        at_end = state.number >= self._profile_ticks
        if not at_end and self._ramping_since is None:
            return False
        if state.demand.omega != REST.omega:
            return False
        since = state.number if self._ramping_since is None else self._ramping_since
        ramped = (state.number - since) * self._period
        return abs(state.demand.vx) < self._standing_speed or ramped > self._longest_ramp
