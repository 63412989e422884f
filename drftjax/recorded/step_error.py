"""Error of simulated channels by the integrator's step.

Implicit Euler has an error of first order, and where a grouser passes within a step its phase
counts. Both hardly change with the numbers that are fitted. So a fit simulates with the step that
was chosen for its run, and takes off what far shorter steps say that this is wrong by: values are
those of short steps at the cost of long ones.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class StepErrorSettings:
    """Numbers of the shorter steps.

    Attributes:
        turn: Angle that a wheel turns by in a step at most [rad]: a tenth of a degree, half of
            that over which a plate of a rolling wheel begins to lead.
        fewest: Steps in place of one at least.
    """

    turn: float = 1.75e-3
    fewest: int = 4


DEFAULT_STEP_ERROR = StepErrorSettings()


def finer_parts(trials: Trial, settings: StepErrorSettings = DEFAULT_STEP_ERROR) -> np.ndarray:
    """Steps to be made in place of one, an even number.

    Args:
        trials: A trial, or several stacked along a leading axis of runs.
        settings: Numbers of the shorter steps.

    Returns:
        Shape () or (runs,).
    """
    radius = np.asarray(trials.simulator.wheel.radius)[..., None]
    rim = np.maximum(np.abs(np.asarray(trials.omega)), np.abs(np.asarray(trials.vx)) / radius)
    parts = np.asarray(trials.step) * rim.max(axis=-1) / settings.turn
    return 2 * np.ceil(np.maximum(parts, settings.fewest) / 2).astype(int)


def step_error(simulated: Callable[[np.ndarray], np.ndarray], parts: np.ndarray) -> np.ndarray:
    """Simulated channels less those of far shorter steps, extrapolated (Richardson).

    Args:
        simulated: Channels with so many steps in place of one.
        parts: Of the shortest steps, even, by `finer_parts`.

    Returns:
        Shape of the channels; zero where one of the three is not finite.
    """
    longer = np.ones_like(parts)
    found, half, fine = (simulated(each) for each in (longer, parts // 2, parts))
    error = found - (2 * fine - half)
    return np.where(np.isfinite(error), error, 0.0)
