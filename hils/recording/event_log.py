"""A run's events, in its own time, which is known only when it starts."""

from hils.clock import AbstractClock
from hils.events import Event
from hils.recording.sinks import RowSink


class EventLog:
    """Takes events before the run's start is known, and after.

    Args:
        rows: Takes them once the run has begun.
        clock: Of their times.
    """

    def __init__(self, rows: RowSink, clock: AbstractClock):
        self._rows, self._clock = rows, clock
        self._early: list[tuple[float, int, float]] = []
        self._start: float | None = None
        self._noted: set[tuple[int, float]] = set()

    def event(self, code: int, arg: float = 0.0) -> None:
        """Log an event that has just happened, and its number."""
        now = self._clock.now()
        if self._start is None:
            self._early.append((now, code, arg))
        else:
            self._rows.event(max(0.0, now - self._start), code, arg)

    def note(self, code: int, arg: float = 0.0) -> None:
        """Log an event once, though the rig reports it again and again."""
        if (code, arg) not in self._noted:
            self._noted.add((code, arg))
            self.event(code, arg)

    def has_noted(self, code: Event, arg: float | None = None) -> bool:
        """Return True where such an event was noted, with this number where one is given."""
        return any(each == code and arg in (None, number) for each, number in self._noted)

    def begin(self, start: float) -> None:
        """Start the run at this time of the clock [s]; earlier events have negative times."""
        self._start = start
        for time, code, arg in self._early:
            self._rows.event(time - start, code, arg)
