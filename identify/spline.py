"""A natural cubic spline through knots, as the straight lines that a simulation takes."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

# Straight lines from a knot to the next: they leave 1/64 of what one line would.
LINES = 8


def between(grid: Float[np.ndarray, " knots"]) -> Float[np.ndarray, " ends"]:
    """Ends of the straight lines that draw a spline through these knots [s]."""
    count = LINES * (len(grid) - 1) + 1
    return np.interp(np.arange(count) / LINES, np.arange(len(grid)), grid)


def cardinal(
    grid: Float[np.ndarray, " knots"], time: Float[np.ndarray, " times"]
) -> Float[np.ndarray, "times knots"]:
    """What a one at each knot, and zeros at the others, gives at `time` [s].

    A spline's values are this matrix times its values at the knots. Before the first knot and after
    the last it is constant.
    """
    inside = np.clip(time, grid[0], grid[-1])
    return CubicSpline(grid, np.eye(len(grid)), bc_type="natural")(inside)
