"""Deadlines of the ticks, absolute from the start of the run."""

from typing import NamedTuple

from hils.clock import AbstractClock, VirtualClock

# A step takes less than this [s]; it is made so long before the tick is due.
WARM_UP = 1.5e-3

# Shorter ticks keep themselves warm [s].
LEAST_PERIOD = 5e-3


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

    def wait_to_warm_up(self, number: int) -> bool:
        """Sleep until shortly before a tick is due, if there is time for a step beforehand.

        Returns:
            True where there is: a step right before the tick brings its code and numbers back into
            the processor's caches, so that the tick's own takes half of the time.
        """
        start = self._start + number * self._period - WARM_UP
        if self._period < LEAST_PERIOD or isinstance(self._clock, VirtualClock):
            return False
        if self._clock.now() >= start:
            return False
        self._clock.sleep_until(start)
        return True

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
