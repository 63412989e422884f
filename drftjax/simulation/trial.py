"""Trial: simulator, start and command of a whole run."""

import math
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.physics.command import Command, command_at
from drftjax.physics.state import Output, State
from drftjax.physics.wheel import AbstractWheel
from drftjax.runlog import record
from drftjax.simulation.rollout import simulate, step_times, sweep, with_first_row
from drftjax.simulation.simulator import Simulator

ROW_INTERVAL = 0.01

# One program serves all runs whose rows and knots round up to the same power of two.
FEWEST_ROWS, FEWEST_KNOTS = 4096, 16


class Trial(eqx.Module):
    """One run to simulate.

    Attributes:
        simulator: Every number of wheel, terrain and rig.
        start: State at the first command.
        time: Knots of the command, from zero on [s], shape (knots,).
        omega: Commanded angular velocity [rad/s], shape (knots,).
        vx: Commanded carriage speed [m/s], shape (knots,); zero where the carriage is free.
        step: Integrator step [s].
        every: Steps from one row of the output to the next.
        rows: Rows of the output after the first, to the end of the command or past it.
        parts: Steps that `run_to` makes in place of one.
    """

    simulator: Simulator
    start: State
    time: Float[Array, " knots"]
    omega: Float[Array, " knots"]
    vx: Float[Array, " knots"]
    step: Float[Array, ""]
    every: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    parts: Int[Array, ""] = eqx.field(converter=partial(jnp.asarray, dtype=int), default=1)

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        start: State,
        command: record.RecordedCommand,
        step: float,
        interval: float = ROW_INTERVAL,
    ) -> "Trial":
        """A trial of a recorded or written command; time counts from its first knot.

        Args:
            simulator: Every number of wheel, terrain and rig.
            start: State at the first command.
            command: Command of the run.
            step: Integrator step [s].
            interval: Time between rows [s], rounded to whole steps.
        """
        time = command.time - command.time[0]
        vx = np.zeros_like(time) if command.vx is None else command.vx
        every = max(1, round(interval / step))
        # A whole row more or less than rounding leaves undecided is one too many.
        rows = math.ceil(float(time[-1]) / (every * step) - 1e-9)
        knots = as_real(time), as_real(command.omega), as_real(vx)
        return cls(simulator, start, *knots, as_real(step), every, rows)

    def run(self) -> Output:
        """Simulate the whole run; past the command's end its last value holds.

        Returns:
            Output with the start as a first row, shape (1 + rows,).
        """
        commands = self.commands()
        _, rows = simulate(self.simulator, self.start, commands, self.step, every=self.every)
        first = Command(self.omega[0], self.vx[0], commands.zeta[0])
        return with_first_row(self.simulator, self.start, first, rows)

    def run_to(self, rows: Int[Array, ""], channels: tuple[str, ...]) -> Float[Array, "channels _"]:
        """Simulate some channels of the first rows only; see `rollout.sweep`.

        Args:
            rows: Rows to make, at most the trial's.
            channels: Fields of the output.

        Returns:
            Channels, zero beyond `rows`, shape (channels, 1 + rows of the trial).
        """
        return self._swept(self.every * self.parts, rows, channels)

    def extrapolated(
        self, rows: Int[Array, ""], channels: tuple[str, ...]
    ) -> Float[Array, "channels _"]:
        """As `run_to`, with the first-order error of the step taken off.

        The run is made with the step and with half of it; twice the second less the first has an
        error of second order (Richardson).
        """
        parts = self.every * self.parts * jnp.asarray([1, 2])
        # One after the other, so that the step stands in the program once.
        coarse, fine = jax.lax.map(lambda each: self._swept(each, rows, channels), parts)
        return 2 * fine - coarse

    def _swept(
        self, parts: Int[Array, ""], rows: Int[Array, ""], channels: tuple[str, ...]
    ) -> Float[Array, "channels _"]:
        def keep(output: Output) -> Float[Array, " channels"]:
            return jnp.stack([getattr(output, each) for each in channels])

        interval = self.every * self.step
        start = self.simulator, self.start, self.command, interval, parts, rows, self.rows
        return sweep(*start, keep)

    def top_speed(self) -> Float[np.ndarray, "*runs"]:
        """Fastest that the wheel turns, or would beside a carriage that slips by nothing [rad/s].

        Of several trials stacked along a leading axis, of each.
        """
        radius = np.asarray(self.simulator.wheel.radius)[..., None]
        return np.maximum(np.abs(self.omega), np.abs(self.vx) / radius).max(axis=-1)

    def command(self, time: Float[Array, ""]) -> Command:
        """The command at a time [s]."""
        return command_at(time, self.time, self.omega, self.vx)

    def commands(self) -> Command:
        """The command at the end of every step, shape (steps,)."""
        times = step_times(self.rows * self.every, self.step)
        return command_at(times, self.time, self.omega, self.vx)


def pad_trial(trial: Trial, rows: int, knots: int) -> Trial:
    """The trial with another number of rows, and its command padded to a number of knots.

    Args:
        trial: Trial of a run.
        rows: Rows of the output after the first.
        knots: Knots of the command, at least the trial's; added ones hold the last value.
    """
    missing = max(0, knots - len(trial.time))
    # In NumPy: a program for every number of knots would take longer than all the padding.
    time, omega, vx = (np.asarray(each) for each in (trial.time, trial.omega, trial.vx))
    later = time[-1] + np.arange(1, missing + 1).astype(float)
    hold = lambda values: jnp.asarray(np.pad(values, (0, missing), mode="edge"))  # noqa: E731
    longer = jnp.asarray(np.concatenate([time, later]))
    return replace(trial, time=longer, omega=hold(omega), vx=hold(vx), rows=rows)


def pad_to_shared_size(trial: Trial) -> Trial:
    """The same run in a shape that runs of about any length, rows and step share.

    Its rows and knots are rounded up, and the steps of a row are a number known at run time, so
    that one compiled program serves them all. The program is to be told how many rows to make.
    """
    steps = replace(trial, every=1, step=trial.every * trial.step, parts=trial.every * trial.parts)
    return pad_trial(steps, shared_size(trial.rows), shared_size(len(trial.time), FEWEST_KNOTS))


def shared_size(number: int, fewest: int = FEWEST_ROWS) -> int:
    """The next power of two, but never a small one: a size that most runs share.

    Args:
        number: Of rows or knots.
        fewest: The smallest size.
    """
    return max(fewest, 1 << (number - 1).bit_length())


def check_output(output: Output, simulator: Simulator) -> None:
    """Refuse a run that the model does not cover.

    Args:
        output: Of the run.
        simulator: That made it.

    Raises:
        InputError: the run diverges, or its wheel sinks deeper than its plates reach.
    """
    finite = jnp.isfinite(output.x) & jnp.isfinite(output.z)
    if not bool(finite.all()):
        when = float(output.time[int(jnp.argmin(finite))])
        raise InputError(f"the simulation diverges near {when:.3g} s; a shorter step may hold it")
    limit = float(_sinkage_limit(simulator.wheel))
    deepest = float(output.sinkage.max())
    if deepest > limit:
        when = float(output.time[int(jnp.argmax(output.sinkage > limit))])
        raise InputError(
            f"the wheel sinks {deepest * 1e3:.4g} mm, past {limit * 1e3:.4g} mm at {when:.3g} s, "
            "where its upper half would touch the sand: the sand is too soft for this load"
        )


@eqx.filter_jit
def _sinkage_limit(wheel: AbstractWheel) -> Float[Array, ""]:
    return wheel.cut().sinkage_limit
