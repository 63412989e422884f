"""Statistics and outcome of one run of the loop."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hils.control.tick import LoopState


class LoopStatistics:
    """Counts and times of the ticks of a run.

    Args:
        room: Ticks whose times are kept; nothing grows while the loop runs.

    Attributes:
        ticks: Ticks made.
        overruns: Deadlines missed, skipped ticks included.
        skipped: Ticks that passed unused.
        fresh: Ticks that had a reading not used before.
        refused: Readings refused.
        old: Readings that answered a command too old to tune by; none where nothing is tuned.
    """

    def __init__(self, room: int):
        self.ticks = self.overruns = self.skipped = self.fresh = self.refused = self.old = 0
        # Filled, so that the memory is taken now: zeros would take it page by page as ticks come.
        self._work_time, self._wake_delay = np.full(room, math.nan), np.full(room, math.nan)
        self._error, self._errors = np.full(room, math.nan), 0

    def add_overrun(self, skipped: int) -> None:
        """Count a missed deadline, or as many as ticks were skipped."""
        self.overruns += max(skipped, 1)
        self.skipped += skipped

    def add_tick(self, work_time: float, wake_delay: float, error: float) -> None:
        """Count a tick.

        Args:
            work_time: From waking to the command being away [s].
            wake_delay: From the due time of the tick, or of the first one skipped before it, to
                waking [s].
            error: Measured minus simulated sinkage [m]; NaN where nothing was compared.
        """
        if self.ticks < len(self._work_time):
            self._work_time[self.ticks] = work_time
            self._wake_delay[self.ticks] = wake_delay
        self.ticks += 1
        if error == error and self._errors < len(self._error):
            self._error[self._errors] = error
            self._errors += 1

    @property
    def work_time(self) -> NDArray[np.float64]:
        """From waking to the command being away, shape (ticks,) [s]."""
        return self._work_time[: self.ticks]

    @property
    def wake_delay(self) -> NDArray[np.float64]:
        """From the due time of a tick, or of the first one skipped before it, to waking, shape
        (ticks,) [s]."""
        return self._wake_delay[: self.ticks]

    @property
    def error(self) -> NDArray[np.float64]:
        """Measured minus simulated sinkage at the ticks that had a reading, shape (compared,)
        [m]."""
        return self._error[: self._errors]


class LoopReport(NamedTuple):
    """Outcome of the loop.

    Attributes:
        reason: Why it ended; "completed" where the profile was run to its end.
        completed: True where the profile was run to its end.
        statistics: Counts and times of the ticks.
        last: State of the loop at the end.
        findings: Sentences on safety rules that fired, and sensors that were stuck.
    """

    reason: str
    completed: bool
    statistics: LoopStatistics
    last: LoopState
    findings: tuple[str, ...] = ()
