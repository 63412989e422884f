"""When a run is asked to move."""

import numpy as np

from drftjax.simulation.trial import Trial

# Wheel and carriage stand where both are asked for this share of their top speed or less, which is
# what a measured or rounded zero leaves.
STANDS = 1e-4


def commanded_speed(radius: float, omega: np.ndarray, vx: np.ndarray | None = None) -> np.ndarray:
    """The faster of rim and carriage [m/s], as they are asked for.

    Args:
        radius: Of the rim [m].
        omega: Commanded angular velocity [rad/s].
        vx: Commanded speed of the carriage [m/s], in the shape of `omega`; none of a free one.
    """
    rim = radius * np.abs(omega)
    return rim if vx is None else np.maximum(rim, np.abs(vx))


def is_commanded_to_move(trial: Trial, time: np.ndarray) -> np.ndarray:
    """Whether wheel or carriage is asked to move at `time` [s], in its shape."""
    knots = np.asarray(trial.time)
    radius = float(trial.simulator.wheel.radius)
    omega, vx = np.asarray(trial.omega), np.asarray(trial.vx)
    here = commanded_speed(radius, np.interp(time, knots, omega), np.interp(time, knots, vx))
    return np.asarray(here > STANDS * commanded_speed(radius, omega, vx).max())
