"""The host's share in an early end: time without a command, and time in which it slept.

A rig whose watchdog waits in vain goes SAFE, and knows nothing of the reason. The host knows when
it sent its commands, and that it slept: the system's clock of uptime stands still while it does,
the clock since the boot runs on.
"""

from dataclasses import dataclass

from hils.clock import time_suspended
from hils.control.stop_request import StopRequest
from hils.events import Event
from hils.link.link import AbstractLink
from hils.link.messages import REASON_MEANINGS, Reason
from hils.recording.event_log import EventLog

REMEDY = "close other programs, or allow SCHED_FIFO (docs/guide/run-a-rig.md)"


@dataclass(frozen=True)
class HostWatchSettings:
    """Delays of the host that are reported.

    Attributes:
        min_sleep: Time asleep that counts [s]; two clocks are read one after the other, and a busy
            machine lets a program wait between the two.
    """

    min_sleep: float = 0.2


DEFAULT_HOST_WATCH = HostWatchSettings()


class HostWatch:
    """Watches this computer over one run, from its construction on.

    Args:
        link: To the rig; it knows when commands were sent.
        log: Takes the event that this computer slept.
        stop: Requests to end the run: an end that was asked for needs no explanation.
        settings: Delays that are reported.
    """

    def __init__(
        self,
        link: AbstractLink,
        log: EventLog,
        stop: StopRequest,
        settings: HostWatchSettings = DEFAULT_HOST_WATCH,
    ):
        self._link, self._log, self._stop, self._settings = link, log, stop, settings
        self._suspended = time_suspended()

    def explain(self, reason: str, completed: bool, watchdog_ms: int) -> str:
        """Reason of a run's end, with this computer's share in it.

        To be called before the rig is brought to rest: afterwards no commands are sent on purpose.

        Args:
            reason: As it is known so far.
            completed: True where the profile was run to its end, so that there is nothing to
                explain.
            watchdog_ms: The rig's watchdog [ms].
        """
        slept = time_suspended() - self._suspended
        if slept >= self._settings.min_sleep:
            self._log.note(Event.HOST_SLEPT, slept)
        if completed or self._stop.first_reason is not None:
            return reason
        if slept >= self._settings.min_sleep:
            return (
                f"{reason}; this computer slept for {slept:.1f} s meanwhile: keep it from going to "
                "sleep during a run"
            )
        pause, watchdog = self._link.quality().longest_pause, watchdog_ms * 1e-3
        if pause > watchdog:
            return (
                f"{reason}; this computer sent no command for {pause:.2f} s (the rig's watchdog is "
                f"{watchdog:.2g} s): {REMEDY}"
            )
        if REASON_MEANINGS[Reason.WATCHDOG] in reason:
            return (
                f"{reason}; this computer sent its commands {pause:.2g} s apart at most (the rig's "
                f"watchdog is {watchdog:.2g} s): the line lost them or held them back"
            )
        return reason
