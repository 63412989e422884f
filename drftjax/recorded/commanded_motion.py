"""Commanded speed of wheel and carriage, and the times at which a run is commanded to move."""

from dataclasses import dataclass

import numpy as np

from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class MotionSettings:
    """Speeds that count as standing.

    Attributes:
        standing_share: Share of the top commanded speed up to which wheel and carriage stand [-]:
            what a measured or rounded zero leaves.
    """

    standing_share: float = 1e-4


DEFAULT_MOTION = MotionSettings()


def commanded_speed(radius: float, omega: np.ndarray, vx: np.ndarray | None = None) -> np.ndarray:
    """Larger of the commanded rim and carriage speed [m/s], in the shape of `omega`.

    Args:
        radius: Rim radius [m].
        omega: Commanded angular velocity [rad/s].
        vx: Commanded speed of the carriage [m/s], in the shape of `omega`; none of a free one.
    """
    rim = radius * np.abs(omega)
    return rim if vx is None else np.maximum(rim, np.abs(vx))


def is_commanded_to_move(
    trial: Trial, time: np.ndarray, settings: MotionSettings = DEFAULT_MOTION
) -> np.ndarray:
    """True where wheel or carriage is commanded to move.

    Args:
        trial: Command of a run.
        time: Times from its first command on [s], of any shape.
        settings: Speeds that count as standing.

    Returns:
        Truth values in the shape of `time`.
    """
    knots = np.asarray(trial.time)
    radius = float(trial.simulator.wheel.radius)
    omega, vx = np.asarray(trial.omega), np.asarray(trial.vx)
    here = commanded_speed(radius, np.interp(time, knots, omega), np.interp(time, knots, vx))
    top = commanded_speed(radius, omega, vx).max()
    return np.asarray(here > settings.standing_share * top)
