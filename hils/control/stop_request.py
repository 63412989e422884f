"""Request to end a run: from a signal, a key or another terminal; checked on each tick."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NamedTuple

from hils.events import Event

STOP_SIGNAL = signal.SIGUSR2


EMERGENCY_SIGNAL = signal.SIGUSR1


EMERGENCY_SIGNALS = (EMERGENCY_SIGNAL, signal.SIGQUIT)


REASON_BY_SIGNAL = {
    signal.SIGINT: "interrupted by Ctrl-C",
    signal.SIGTERM: "asked to stop (SIGTERM)",
    signal.SIGHUP: "the terminal was closed",
    STOP_SIGNAL: "stopped by the operator",
    EMERGENCY_SIGNAL: "asked for by the operator",
    signal.SIGQUIT: "Ctrl-\\",
}


EVENT_BY_SIGNAL = {STOP_SIGNAL: Event.STOP_ASKED}


class StopReason(NamedTuple):
    """Reason why a run is to end.

    Attributes:
        reason: In words.
        event: As the run log has it.
        arg: Its number.
    """

    reason: str
    event: Event
    arg: float = 0.0


class StopRequest:
    """Requests to end a run, and the kind of end.

    Attributes:
        first_reason: First request to ramp down; None while there is none.
        emergency: True where the rig is to rest at once, as a second request asks for too.
        uninterruptible: True while a signal must not interrupt anything, as the rig may move, or
            the outcome of the run is not yet shown.
    """

    def __init__(self):
        self.first_reason: StopReason | None = None
        self.emergency = False
        self.uninterruptible = False

    @property
    def reason(self) -> str:
        """Reason why the run is to end, in words."""
        why = "" if self.first_reason is None else self.first_reason.reason
        if not self.emergency:
            return why
        return f"emergency stop: {why}" if why else "emergency stop"

    def ask(self, reason: StopReason, emergency: bool = False) -> None:
        """Ask for the run's end; to ask twice is to ask for an emergency stop."""
        self.emergency = self.emergency or emergency or self.first_reason is not None
        self.first_reason = self.first_reason or reason

    @contextmanager
    def on_signals(self) -> Iterator[None]:
        """Context in which the signals that would end the program ask for the run's end instead.

        While nothing moves they interrupt whatever is at work, such as a question, as well.
        """

        def asked(number: int, frame: FrameType | None) -> None:
            kind = signal.Signals(number)
            emergency = kind in EMERGENCY_SIGNALS
            event = (
                Event.EMERGENCY_STOP if emergency else EVENT_BY_SIGNAL.get(kind, Event.INTERRUPTED)
            )
            self.ask(StopReason(REASON_BY_SIGNAL[kind], event, number), emergency)
            if not self.uninterruptible:
                raise KeyboardInterrupt

        before = {kind: signal.signal(kind, asked) for kind in REASON_BY_SIGNAL}
        try:
            yield
        finally:
            for kind, handler in before.items():
                # A second press of a stop key that finds the program leaving must not kill it.
                late = kind in (STOP_SIGNAL, EMERGENCY_SIGNAL) and handler == signal.SIG_DFL
                signal.signal(kind, signal.SIG_IGN if late else handler)
