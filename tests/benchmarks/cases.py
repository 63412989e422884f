"""What is measured: the paper's 24 s profile, once, 256 and 4,096 times."""

from dataclasses import asdict, dataclass

import numpy as np

from drftjax.simulation.speed import ENSEMBLE_ZETA, TIMES

DURATION = float(TIMES[-1])
# z is compared while the wheel turns: the yardstick smooths rest over 0.1 mm/s and creeps [s].
TURNS, STOPS = 2.0, 22.0
# Of the many, from full speed on. Before, light sand lets the wheel drop from its starting height,
# and where it is caught hangs on the last digit of step and plates.
DRIVEN = 7.0
PAPER_ZETA = 0.7823
# So many runs of an ensemble, both ends among them, are held against the fine solution.
CHECKED = 16


def zetas_of(runs: int) -> np.ndarray:
    """Scaling factors of an ensemble, as the yardstick has them; shape (runs,)."""
    return np.linspace(*ENSEMBLE_ZETA, runs)


def checked(runs: int) -> np.ndarray:
    """Indices of the runs that are held against the fine solution, shape (16,)."""
    return np.linspace(0, runs - 1, CHECKED).round().astype(int)


@dataclass(frozen=True)
class Case:
    """One set-up of ours.

    Attributes:
        runs: 1, or an ensemble.
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


# The step that is chosen for the paper's run; z and the final x are told beside the times.
SINGLE = Case(1, 1e-2, 0.005, row=0.02)
ENSEMBLES = (Case(256, 1e-2, 0.004), Case(4096, 1e-2, 0.004))

FINE = Case(CHECKED, 5e-4, 5e-4)

STUDY_STEPS = (1e-3, 2e-3, 2.5e-3, 4e-3, 5e-3, 1e-2)
STUDY_PLATES = (0.002, 0.004, 0.006, 0.008)

# Its largest step for 0.05 mm in the single run; in some of the many it already chatters at rest.
YARDSTICK_DT = 2e-3
