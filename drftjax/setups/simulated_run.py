"""Simulation of a set-up as a run log."""

import copy
import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Int

from drftjax import __version__
from drftjax.common.errors import InputError
from drftjax.common.text import replace_unprintable
from drftjax.physics.state import Output
from drftjax.runlog import record
from drftjax.setups.chosen_step import choose_setup_step, step_within
from drftjax.setups.command_knots import extend_command
from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import ROW_INTERVAL, Trial, check_output, pad_to_shared_size

CHANNELS = tuple(field.name for field in dataclasses.fields(Output))


@eqx.filter_jit
def _run(trial: Trial, rows: Int[Array, ""]) -> Output:
    return Output(*trial.extrapolated(rows, CHANNELS))


# Rounding of the times of rows, written in decimals [s].
ROUNDING = 1e-9


def simulated_run(
    setup: SetUp, interval: float = ROW_INTERVAL, at: np.ndarray | None = None
) -> record.RunLog:
    """Simulate a set-up and give the run as a run log, forces and torque included.

    Args:
        setup: Set-up to simulate.
        interval: Time between rows [s]; rounded to whole steps where the set-up gives a step.
        at: Times of the rows [s], shape (rows,), by interpolation; past the command's end its last
            value holds.

    Returns:
        The run; its notes tell the step that was chosen where the set-up gives none.

    Raises:
        InputError: a number of the set-up is out of bounds, or the model does not cover the run.
    """
    if at is not None and len(at) > 1:
        interval = min(interval, float(np.median(np.diff(at))))
    command = setup.command.build()
    end = command.time[-1] + ROUNDING
    held = setup
    if at is not None and len(at) and at[-1] > end:
        held = msgspec.structs.replace(setup, command=extend_command(at[-1], setup.command))
    lasts = held.command.time[-1] - held.command.time[0]
    if interval > lasts + ROUNDING:
        raise InputError(
            f"rows {interval:g} s apart are farther than the command lasts ({lasts:g} s); ask for "
            "more rows a second"
        )
    setup, held = copy.deepcopy(setup), copy.deepcopy(held)
    choice = choose_setup_step(held)
    if choice is not None:
        held.integrator.step = step_within(interval, choice.step)
    trial = held.trial(interval)
    output = _run(pad_to_shared_size(trial), jnp.asarray(trial.rows))
    check_output(output, trial.simulator)
    output = jax.tree.map(lambda values: np.asarray(values)[: trial.rows + 1], output)
    time = output.time + command.time[0]
    rows = time[time <= end] if at is None else at
    measured = {name: np.interp(rows, time, getattr(output, name)) for name in record.CHANNELS}
    return record.RunLog(
        setup=with_believed_values(setup, setup.start.sinkage, float(output.zeta[0])),
        command=command,
        measured=record.Measured(time=rows, **measured),
        source="simulated",
        title=setup.title,
        notes=None if choice is None else f"{choice}",
        software="drftjax",
        software_version=__version__,
    )


def with_believed_values(setup: SetUp, sinkage: float, zeta: float) -> record.RecordedSetup:
    """Set-up of a run log: the numbers of a `SetUp` that it records, and those found at rest.

    Args:
        setup: The operator's model of wheel, sand and rig.
        sinkage: H at rest [m].
        zeta: Scaling factor at the start [-]; NaN of a wheel that hangs in the air, which has
            neither.
    """
    in_the_air = math.isnan(zeta)
    wheel = setup.wheel
    grousers = wheel.shape == "grouser"
    return record.RecordedSetup(
        wheel_radius=wheel.radius,
        # A run log has no place for an outline: without a width nothing takes it for a plain rim.
        wheel_width=None if wheel.shape == "outline" else wheel.width,
        grouser_count=wheel.grouser_count if grousers else 0,
        grouser_height=wheel.grouser_height * wheel.grouser_fraction if grousers else None,
        grouser_thickness=wheel.grouser_thickness if grousers else None,
        mass_x=setup.rig.mass_x,
        mass_z=setup.rig.mass_z,
        gravity=setup.rig.gravity,
        bulk_density=getattr(setup.terrain, "bulk_density", None),
        sinkage_static=None if in_the_air else sinkage,
        scaling_factor_initial=None if in_the_air else zeta,
    )


def summary(run: record.RunLog) -> str:
    """A run in one sentence: duration, deepest and final sinkage, and travel."""
    measured = run.measured
    lasts = measured.time[-1] - measured.time[0]
    assert measured.x is not None
    assert measured.z is not None
    return (
        f"{replace_unprintable(run.title)}: {lasts:.4g} s, "
        f"deepest sinkage {-measured.z.min() * 1e3:.2f} mm, "
        f"final sinkage {-measured.z[-1] * 1e3:.2f} mm, "
        f"travel {measured.x[-1] - measured.x[0]:.4f} m"
    )
