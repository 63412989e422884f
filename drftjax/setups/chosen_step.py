"""Step of a set-up that gives none, chosen for its run."""

import math

from drftjax.setups.setup import SetUp
from drftjax.simulation.step_choice import DEFAULT_STEPS, StepChoice, StepSettings, choose_step


def choose_setup_step(setup: SetUp, settings: StepSettings = DEFAULT_STEPS) -> StepChoice | None:
    """Choose the step of a set-up that gives none, and write it into its [integrator].

    Args:
        setup: Changed in place.
        settings: Limits of the error.

    Returns:
        The choice, with the estimate of its error; None where the set-up gives a step.

    Raises:
        InputError: a number of the set-up is out of bounds.
    """
    if setup.integrator.step is not None:
        return None
    choice = choose_step(setup.trial(), settings)
    setup.integrator.step = choice.step
    return choice


def step_within(interval: float, step: float) -> float:
    """The longest step that divides an interval evenly and is no longer than another [s].

    Args:
        interval: To be divided [s], a loop's tick or the time between rows.
        step: Longest step [s].
    """
    # A step that divides evenly but for rounding is not divided once more.
    return interval / math.ceil(interval / step - 1e-9)
