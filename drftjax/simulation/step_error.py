"""Error of simulated channels by the integrator's step.

Implicit Euler has an error of first order, and where a grouser passes within a step its phase
counts. Both hardly change with the numbers that are fitted. So a fit simulates with the step that
was chosen for its run, and takes off what far shorter steps say that this is wrong by: values are
those of short steps at the cost of long ones.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class StepErrorSettings:
    """Numbers of the shorter steps.

    Attributes:
        turn: Angle that a wheel turns by in a step at most [rad]: a tenth of a degree, well under
            that over which a plate of a rolling wheel begins to lead (3e-3).
        refinement: Steps in place of one at least, an even number.
    """

    turn: float = 1.75e-3
    refinement: int = 4


DEFAULT_STEP_ERROR = StepErrorSettings()


def parts_within_turn(
    trials: Trial, settings: StepErrorSettings = DEFAULT_STEP_ERROR
) -> Int[np.ndarray, "*runs"]:
    """Steps to be made in place of one, so that none turns the wheel by more than `turn`.

    Args:
        trials: A trial, or several stacked along a leading axis of runs.
        settings: Numbers of the shorter steps.
    """
    turned = np.asarray(trials.step) * trials.top_speed()
    return np.maximum(1, np.ceil(turned / settings.turn)).astype(int)


def step_error(
    simulated: Callable[[np.ndarray], np.ndarray],
    trials: Trial,
    settings: StepErrorSettings = DEFAULT_STEP_ERROR,
    known: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Simulated channels less those of far shorter steps, extrapolated (Richardson).

    Args:
        simulated: Channels with so many steps in place of one, by run.
        trials: A trial, or several stacked along a leading axis of runs.
        settings: Numbers of the shorter steps.
        known: An error from elsewhere, such as from other parameters, shape of the channels.

    Returns:
        Shape of the channels; what is known where one of the three is not finite.
    """
    parts = np.asarray(trials.parts)
    enough = np.maximum(settings.refinement * parts, parts_within_turn(trials, settings))
    finest = 2 * np.ceil(enough / 2).astype(int)
    found, half, fine = (simulated(each) for each in (parts, finest // 2, finest))
    error = found - (2 * fine - half)
    return np.where(np.isfinite(error), error, known)
