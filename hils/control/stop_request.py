"""A wish to end the run: from a signal, a key or another terminal; looked at on each tick."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NamedTuple

from hils.events import Event

STOP_SIGNAL = signal.SIGUSR2


EMERGENCY_SIGNAL = signal.SIGUSR1


EMERGENCIES = (EMERGENCY_SIGNAL, signal.SIGQUIT)


WISHES = {
    signal.SIGINT: "interrupted by Ctrl-C",
    signal.SIGTERM: "asked to stop (SIGTERM)",
    signal.SIGHUP: "the terminal was closed",
    STOP_SIGNAL: "stopped by the operator",
    EMERGENCY_SIGNAL: "asked for by the operator",
    signal.SIGQUIT: "Ctrl-\\",
}


EVENTS = {STOP_SIGNAL: Event.STOP_ASKED}


class StopReason(NamedTuple):
    """Why the run is to end.

    Attributes:
        reason: In words.
        event: As the run log has it.
        arg: Its number.
    """

    reason: str
    event: Event
    arg: float = 0.0


class StopRequest:
    """Whether the run is to end, and how.

    Attributes:
        wish: The first wish to ramp down; None while there is none.
        emergency: Whether the rig is to rest at once, which a second wish asks for too.
        uncut: Whether a signal must not cut anything short, as the rig may move, or the run that
            it made is not told yet.
    """

    def __init__(self):
        self.wish: StopReason | None = None
        self.emergency = False
        self.uncut = False

    @property
    def reason(self) -> str:
        """Why the run is to end, in words."""
        why = "" if self.wish is None else self.wish.reason
        if not self.emergency:
            return why
        return f"emergency stop: {why}" if why else "emergency stop"

    def ask(self, wish: StopReason, emergency: bool = False) -> None:
        """Ask for the run's end; to ask twice is to ask for an emergency stop."""
        self.emergency = self.emergency or emergency or self.wish is not None
        self.wish = self.wish or wish

    @contextmanager
    def on_signals(self) -> Iterator[None]:
        """Within this, the signals that would end the program ask for the run's end instead.

        While nothing moves they interrupt whatever is at work, such as a question, as well.
        """

        def asked(number: int, frame: FrameType | None) -> None:
            kind = signal.Signals(number)
            emergency = kind in EMERGENCIES
            event = Event.EMERGENCY_STOP if emergency else EVENTS.get(kind, Event.INTERRUPTED)
            self.ask(StopReason(WISHES[kind], event, number), emergency)
            if not self.uncut:
                raise KeyboardInterrupt

        before = {kind: signal.signal(kind, asked) for kind in WISHES}
        try:
            yield
        finally:
            for kind, handler in before.items():
                # A second press of a stop key that finds the program leaving must not kill it.
                late = kind in (STOP_SIGNAL, EMERGENCY_SIGNAL) and handler == signal.SIG_DFL
                signal.signal(kind, signal.SIG_IGN if late else handler)
