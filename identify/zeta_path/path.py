"""zeta over a run as a natural cubic spline of log zeta."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial
from identify.zeta_path.settings import ZETA_PATH_SETTINGS, ZetaPathSettings

# Straight segments from a knot to the next: the error is 1/64 of that of one segment.
SEGMENTS = 8


CHANNELS = ("z", "x")


def segment_ends(grid: Float[np.ndarray, " knots"]) -> Float[np.ndarray, " ends"]:
    """Return the ends of the straight segments that draw a spline through these knots [s]."""
    count = SEGMENTS * (len(grid) - 1) + 1
    return np.interp(np.arange(count) / SEGMENTS, np.arange(len(grid)), grid)


def cardinal_splines(
    grid: Float[np.ndarray, " knots"], time: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "times knots"]:
    """Return, for each knot, the natural cubic spline that is one there and zero at the others.

    The values of a spline are this matrix times its values at the knots. Before the first knot and
    after the last it is constant.

    Args:
        grid: Knots [s].
        time: Where the splines are read [s].
    """
    inside = np.clip(time, grid[0], grid[-1])
    return CubicSpline(grid, np.eye(len(grid)), bc_type="natural")(inside)


@dataclass(frozen=True, eq=False)
class ZetaPath:
    """zeta(t) of one run.

    Attributes:
        name: Name of the run in reports.
        time: Knots from the run's start [s], shape (knots,).
        value: zeta there [-]; its logarithm is a natural cubic spline between them.
        error: Standard errors [-]; infinite where no sample depends on a knot.
        identified: True where the knot's own samples determine it, shape (knots,).
        weight: Weight w of the squared second differences of log zeta.
        noise: Standard deviation and lag-one correlation of the residual, by channel [m], [-].
        rmse: Root mean square of simulated minus recorded where compared, by channel [m].
        steps: Gauss-Newton steps taken.
        converged: True where they converged.
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

    def at(self, time: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
        """Return zeta [-] at `time` [s], on the spline through the knots."""
        return np.exp(cardinal_splines(self.time, np.asarray(time)) @ np.log(self.value))

    def contradiction(self, settings: ZetaPathSettings = ZETA_PATH_SETTINGS) -> str | None:
        """Return a sentence where no zeta(t) explains sinkage and travel both, else None."""
        sinkage, travel = (self.rmse.get(name, 0.0) for name in CHANNELS)
        if travel <= settings.contradiction_ratio * sinkage:
            return None
        sinkage, travel = (f"{1e3 * each:.2g} mm" for each in (sinkage, travel))
        return (
            f"{self.name}: a zeta(t) that matches the sinkage to {sinkage} leaves travel {travel} "
            "off: what moves zeta here is not the sand's strength alone"
        )
