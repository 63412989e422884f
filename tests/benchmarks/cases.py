"""What is measured: the paper's 24 s profile, once and 256 times."""

from dataclasses import asdict, dataclass

import numpy as np

DURATION = 24.0
# The wheel turns at full speed from here on. Before, light sand lets the wheel drop from its
# starting height, and where it is caught hangs on the last digit of step and plates.
DRIVEN = 7.0
PAPER_ZETA = 0.7823
RUNS = 256
ZETAS = np.linspace(0.6, 1.0, RUNS)
# Every 17th run, both ends among them, is held against the fine solution.
CHECKED = np.arange(0, RUNS, 17)


@dataclass(frozen=True)
class Case:
    """One set-up of ours.

    Attributes:
        runs: 1, or all of `ZETAS`.
        dt: Step [s].
        plate_size: Longest plate [m].
        row: Time between the rows kept [s].
    """

    runs: int
    dt: float
    plate_size: float
    row: float = 0.1

    @property
    def every(self) -> int:
        return round(self.row / self.dt)

    def words(self) -> dict:
        return asdict(self)


# The largest step at which z stays within 0.05 mm of the reference run and the stop is quiet.
SINGLE = Case(1, 5e-3, 0.004, row=0.02)
# As close to the fine solution as the yardstick's plates bring it, at the largest step for that ...
EQUAL = Case(RUNS, 5e-3, 0.004)
# ... at the yardstick's own step ...
ALIKE = Case(RUNS, 2e-3, 0.004)
# ... and within 0.05 mm, which the yardstick's plates do not reach at any step.
CLOSE = Case(RUNS, 2.5e-3, 0.002)

FINE = Case(len(CHECKED), 5e-4, 5e-4)

STUDY_STEPS = (1e-3, 2e-3, 2.5e-3, 4e-3, 5e-3, 1e-2)
STUDY_PLATES = (0.002, 0.004, 0.006, 0.008)

# Its largest step for 0.05 mm in the single run; in some of the many it already chatters at rest.
YARDSTICK_DT = 2e-3
