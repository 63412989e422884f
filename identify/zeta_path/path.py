"""zeta over a run as a natural cubic spline."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial

# Straight lines from a knot to the next: they leave 1/64 of what one line would.
SEGMENTS = 8


def segment_ends(grid: Float[np.ndarray, " knots"]) -> Float[np.ndarray, " ends"]:
    """Ends of the straight lines that draw a spline through these knots [s]."""
    count = SEGMENTS * (len(grid) - 1) + 1
    return np.interp(np.arange(count) / SEGMENTS, np.arange(len(grid)), grid)


def cardinal_splines(
    grid: Float[np.ndarray, " knots"], time: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "times knots"]:
    """What a one at each knot, and zeros at the others, gives at `time` [s].

    A spline's values are this matrix times its values at the knots. Before the first knot and after
    the last it is constant.
    """
    inside = np.clip(time, grid[0], grid[-1])
    return CubicSpline(grid, np.eye(len(grid)), bc_type="natural")(inside)


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
    identified: np.ndarray
    weight: float
    noise: dict[str, tuple[float, float]]
    rmse: dict[str, float]
    steps: int
    converged: bool
    trial: Trial
    setup: SetUp

    def at(self, time: np.ndarray) -> np.ndarray:
        """zeta at `time` [s], on the spline through the knots."""
        return np.exp(cardinal_splines(self.time, np.asarray(time)) @ np.log(self.value))

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
