"""zeta(t) of one recorded run, as it was found offline."""

from dataclasses import dataclass

import numpy as np

from drftjax.setup import SetUp
from drftjax.trial import Trial
from identify.spline import cardinal

CHANNELS = ("z", "x")
# Travel left so many times worse than sinkage says that no zeta(t) meets both.
AT_ODDS = 20.0


@dataclass(frozen=True, eq=False)
class ZetaPath:
    """zeta(t) of one run.

    Attributes:
        name: The run, as reports call it.
        time: Knots from the run's start [s], shape (knots,).
        value: zeta there [-]; its logarithm is a natural cubic spline between them.
        error: Standard errors [-]; infinite where no sample depends on a knot.
        told: Whether the knot's own samples tell anything of it.
        weight: Weight w of the squared second differences of log zeta.
        noise: Standard deviation and lag-one correlation of the residual, by channel [m], [-].
        rmse: Root mean square of simulated minus recorded where compared, by channel [m].
        steps: Gauss-Newton steps taken.
        converged: Whether they settled.
        trial: The fitted trial.
        setup: Its set-up.
    """

    name: str
    time: np.ndarray
    value: np.ndarray
    error: np.ndarray
    told: np.ndarray
    weight: float
    noise: dict[str, tuple[float, float]]
    rmse: dict[str, float]
    steps: int
    converged: bool
    trial: Trial
    setup: SetUp

    def at(self, time: np.ndarray) -> np.ndarray:
        """zeta at `time` [s], on the spline through the knots."""
        return np.exp(cardinal(self.time, np.asarray(time)) @ np.log(self.value))

    def contradiction(self) -> str | None:
        """In words, that no zeta(t) meets both sinkage and travel; None where one does."""
        left = [self.rmse.get(name, 0.0) for name in CHANNELS]
        if left[1] <= AT_ODDS * left[0]:
            return None
        sinkage, travel = (f"{1e3 * each:.2g} mm" for each in left)
        return (
            f"{self.name}: a zeta(t) that meets the sinkage to {sinkage} leaves travel {travel} "
            "off: what moves zeta here is not the sand's strength alone"
        )
