"""Runs of a set-up: `simulate` as a run log, `trajectory` as arrays that JAX differentiates."""

from os import PathLike
from typing import Any

import equinox as eqx
import jax
import jax.core as jax_core
import numpy as np

from drftjax.common.errors import InputError
from drftjax.physics.state import Output
from drftjax.runlog.record import RunLog
from drftjax.setups.numbers import with_numbers
from drftjax.setups.setup import SetUp, read_setup
from drftjax.setups.simulated_run import simulated_run
from drftjax.simulation.trial import ROW_INTERVAL, Trial, check_output


def as_setup(setup: SetUp | str | PathLike[str]) -> SetUp:
    """A set-up as it is, or read from its file.

    Raises:
        InputError: names the file and the entry; or says what was given in place of a set-up.
    """
    if isinstance(setup, SetUp):
        return setup
    if isinstance(setup, str | PathLike):
        return read_setup(setup)  # pyright: ignore[reportArgumentType]
    raise InputError(f"a {type(setup).__name__} was given, must be a SetUp or the path of its file")


def simulate(
    setup: SetUp | str | PathLike[str],
    *,
    interval: float = ROW_INTERVAL,
    at: np.ndarray | None = None,
    **numbers: Any,
) -> RunLog:
    """Simulate a set-up, as `drft simulate` does.

    Args:
        setup: Set-up, or the path of its file.
        interval: Time between rows [s].
        at: Times of the rows [s], shape (rows,), in place of the interval.
        numbers: Numbers in place of the set-up's, by name: `zeta=0.7`, `mass_z=20`; those of
            effects as `**{"loosening.loss": 0.2}`.

    Returns:
        The run; its notes tell the step that was chosen where the set-up gives none.

    Raises:
        InputError: a number of the set-up is out of bounds, or the model does not cover the run.
    """
    return simulated_run(with_numbers(as_setup(setup), numbers), interval, at)


def trajectory(
    setup: SetUp | str | PathLike[str], *, interval: float = ROW_INTERVAL, **numbers: Any
) -> Output:
    """Trajectory of a set-up as JAX arrays, differentiable by its numbers forward and backward.

    It is made with the set-up's step, or with 2.5 ms where it gives none.

    Args:
        setup: Set-up, or the path of its file.
        interval: Time between rows [s].
        numbers: Numbers in place of the set-up's, as of `simulate`; `jax.grad` may trace them.

    Returns:
        Output with the start as a first row, shape (1 + rows,).

    Raises:
        InputError: a number is out of bounds, is traced and decides the number of plates or steps,
            or the model does not cover the run.
    """
    try:
        trial = with_numbers(as_setup(setup), numbers).trial(interval)
    except jax.errors.ConcretizationTypeError:
        raise InputError(
            f"one of {', '.join(numbers)} decides the number of plates or steps, or is an entry "
            "that is no number; there is no derivative by it"
        ) from None
    output = _run(trial)
    if not isinstance(output.z, jax_core.Tracer):
        check_output(output, trial.simulator)
    return output


@eqx.filter_jit
def _run(trial: Trial) -> Output:
    return trial.run()
