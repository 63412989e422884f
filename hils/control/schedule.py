"""Deadlines of the ticks, absolute from the start of the run."""

from typing import NamedTuple

from hils.clock import AbstractClock


class TickStart(NamedTuple):
    """Start of one tick.

    Attributes:
        number: Of the tick, past those that were skipped.
        skipped: Ticks that passed unused before it.
        due: Due time of the tick, or of the first one skipped before it [s].
        woken: Time at which the loop woke [s].
    """

    number: int
    skipped: int
    due: float
    woken: float


class TickSchedule:
    """Times of the ticks: tick n is due at start + n * period, and its deadline is the next one.

    Args:
        clock: Of the loop.
        period: Control period [s].
    """

    def __init__(self, clock: AbstractClock, period: float):
        self._clock, self._period, self._start = clock, period, 0.0

    def begin(self, start: float) -> None:
        """Let tick 0 be due at this time of the clock [s]."""
        self._start = start

    def now(self) -> float:
        """Time on the clock [s]."""
        return self._clock.now()

    def sleep_until(self, number: int) -> float:
        """Sleep until a tick is due.

        Returns:
            Time at which it is due [s].
        """
        due = self._start + number * self._period
        self._clock.sleep_until(due)
        return due

    def wait_for(self, number: int) -> TickStart:
        """Sleep until a tick is due, and skip all ticks that have passed on waking."""
        due = self.sleep_until(number)
        woken, current = self._clock.now(), number
        while woken >= self._start + (current + 1) * self._period:
            current += 1
        return TickStart(current, current - number, due, woken)

    def overrun(self, tick: TickStart, now: float) -> float:
        """Time past the deadline of a tick [s]; negative before it."""
        return now - (self._start + (tick.number + 1) * self._period)

    def lateness(self, tick: TickStart, now: float) -> float:
        """Time past the deadline of a tick, or of the first one skipped before it [s]."""
        return now - (tick.due + self._period) if tick.skipped else self.overrun(tick, now)
