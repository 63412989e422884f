"""The clock that a run goes by: real, or virtual for tests and studies."""

import abc
import math
import time
from typing import Protocol


def time_suspended() -> float:
    """Time for which this computer has slept since it was booted [s].

    It is what the clock since the boot is ahead of the monotonic clock, which stands still
    meanwhile; 0 where the system has no such clock.
    """
    if not hasattr(time, "CLOCK_BOOTTIME"):
        return 0.0
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)


class AbstractClock(abc.ABC):
    """Seconds that never go back, from an origin of its own."""

    @abc.abstractmethod
    def now(self) -> float:
        """Time [s]."""

    @abc.abstractmethod
    def sleep_until(self, deadline: float) -> None:
        """Return at this time [s], or at once where it has passed."""


class MonotonicClock(AbstractClock):
    """The operating system's monotonic clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        while (left := deadline - time.monotonic()) > 0:
            time.sleep(left)


class ClockFollower(Protocol):
    """Something that is advanced by a virtual clock."""

    def advance(self, now: float) -> None:
        """Advance to this time [s]."""


class VirtualClock(AbstractClock):
    """Time that passes when someone sleeps, and takes none.

    Args:
        start: First reading [s].
        grain: Longest step in which its followers are advanced [s].
    """

    def __init__(self, start: float = 0.0, grain: float = 1e-3):
        self._now = start
        self._grain = grain
        self._followers: list[ClockFollower] = []

    def attach(self, follower: ClockFollower) -> None:
        """Let this clock advance a follower."""
        self._followers.append(follower)

    def now(self) -> float:
        return self._now

    def sleep_until(self, deadline: float) -> None:
        start = self._now
        # A hair less than a whole grain is not worth a stretch of its own.
        stretches = math.ceil((deadline - start) / self._grain - 1e-6)
        for number in range(1, stretches + 1):
            self._now = deadline if number == stretches else start + number * self._grain
            for follower in self._followers:
                follower.advance(self._now)
        self._now = max(self._now, deadline)
