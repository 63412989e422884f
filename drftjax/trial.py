"""A trial: a simulator, where it starts and what it is commanded, over a whole run."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.arrays import as_real
from drftjax.command import Command, command_at
from drftjax.errors import InputError
from drftjax.rollout import simulate, step_times, with_first_row
from drftjax.runlog import record
from drftjax.simulator import Output, Simulator, State

ROW_INTERVAL = 0.01


class Trial(eqx.Module):
    """One run to simulate.

    Attributes:
        simulator: Every number of wheel, terrain and rig.
        start: State at the first command.
        time: Knots of the command, from `start.time` on [s], shape (knots,).
        omega: Commanded angular velocity [rad/s], shape (knots,).
        vx: Commanded carriage speed [m/s], shape (knots,); zero where the carriage is free.
        step: Integrator step [s].
        steps: Steps to the end of the command.
    """

    simulator: Simulator
    start: State
    time: Float[Array, " knots"]
    omega: Float[Array, " knots"]
    vx: Float[Array, " knots"]
    step: float = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    @classmethod
    def of(
        cls, simulator: Simulator, start: State, command: record.Command, step: float
    ) -> "Trial":
        """A trial of a recorded or written command; time counts from its first knot."""
        time = command.time - command.time[0]
        vx = np.zeros_like(time) if command.vx is None else command.vx
        steps = round(float(time[-1]) / step)
        if steps < 1:
            raise InputError(f"the command lasts {time[-1]:g} s, less than a step of {step:g} s")
        return cls(
            simulator, start, as_real(time), as_real(command.omega), as_real(vx), step, steps
        )

    def run(self, interval: float = ROW_INTERVAL) -> Output:
        """The whole run, a row about every `interval` [s], the start as its first row.

        The interval is rounded to whole steps, and the last row may lie past the command's end,
        where its last value holds.
        """
        every = max(1, round(interval / self.step))
        times = step_times(every * math.ceil(self.steps / every), self.step)
        commands = command_at(times, self.time, self.omega, self.vx)
        _, rows = simulate(self.simulator, self.start, commands, self.step, every=every)
        first = Command(self.omega[0], self.vx[0], commands.zeta[0])
        return with_first_row(self.simulator, self.start, first, rows)


def check_output(output: Output, simulator: Simulator) -> None:
    """Refuse a run that left what the model covers.

    Raises:
        InputError: says when, and what left it.
    """
    finite = jnp.isfinite(output.x) & jnp.isfinite(output.z)
    if not bool(finite.all()):
        when = float(output.time[int(jnp.argmin(finite))])
        raise InputError(
            f"the simulation diverges near {when:.3g} s; a shorter step, or the method "
            "'held pace', may hold it"
        )
    limit = float(simulator.wheel.cut().sinkage_limit)
    deepest = float(output.sinkage.max())
    if deepest > limit:
        when = float(output.time[int(jnp.argmax(output.sinkage > limit))])
        raise InputError(
            f"the wheel sinks {deepest * 1e3:.4g} mm, past {limit * 1e3:.4g} mm at {when:.3g} s, "
            "where its upper half would touch the sand: the sand is too soft for this load"
        )
