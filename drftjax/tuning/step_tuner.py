r"""Online tuner of Fuke, Ishikawa & Ishigami 2024, eq. 7: zeta follows the measured sinkage.

On each control tick the measured sinkage is compared with the simulated one, and zeta changes by
one fixed step where they differ by more than a tolerance:

$$H_{real} - H_{sim} < -\epsilon_H:\ \zeta \to \zeta + \Delta\zeta \qquad
  H_{real} - H_{sim} > \epsilon_H:\ \zeta \to \zeta - \Delta\zeta$$

`drftjax.tuning.replay` steps the same tick beside a recorded run.
"""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import Real, as_real, require_between
from drftjax.physics.command import Command, command_at
from drftjax.physics.state import Output, State
from drftjax.physics.terrain import LARGEST_ZETA, PerStepZeta
from drftjax.simulation.rollout import step_times
from drftjax.simulation.simulator import Simulator

# Ticks of the paper's kind; longer ones are a slip of units [s].
LONGEST_TICK = 10.0


# Memory of a tuner from tick to tick: any tree of arrays.
Memory = Any


# One tick of the simulator: a state and zeta [-] to the state and the output at the tick's end.
Advance = Callable[[State, Float[Array, ""]], tuple[State, Output]]


class AbstractTuner(eqx.Module):
    """Law that changes zeta by the error of the sinkage, once a tick.

    Attributes:
        tick: Control period [s].
    """

    tick: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def begin(self, state: State, zeta: Float[Array, ""]) -> Memory:
        """Memory before the first tick.

        Args:
            state: Simulated wheel at the start.
            zeta: Scaling factor at the start [-].
        """

    @abc.abstractmethod
    def tune(
        self, memory: Memory, zeta: Float[Array, ""], error: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Memory]:
        """zeta for the tick that begins.

        Args:
            memory: After the tick before.
            zeta: Scaling factor over the tick before [-].
            error: Recorded minus simulated sinkage [m]; NaN where nothing was recorded, and then
                zeta stays as it is.

        Returns:
            zeta [-], and the memory.
        """

    @abc.abstractmethod
    def follow(
        self, memory: Memory, advance: Advance, state: State, zeta: Float[Array, ""]
    ) -> tuple[State, Output, Memory]:
        """Simulate the tick; a tuner may differentiate the simulation for its memory.

        Args:
            memory: As `tune` returned it.
            advance: Simulates the tick.
            state: Simulated wheel at the tick's start.
            zeta: Scaling factor over the tick [-].

        Returns:
            State and output at the tick's end, and the memory.
        """


class StepTuner(AbstractTuner):
    """Eq. 7: one fixed step up or down, or none.

    Attributes:
        tick: Control period [s].
        zeta_step: Change of zeta on one tick [-]; zero holds zeta.
        tolerance: Error of the sinkage that is left alone [m].
    """

    tick: Float[Array, ""] = eqx.field(converter=as_real, default=0.01)
    zeta_step: Float[Array, ""] = eqx.field(converter=as_real, default=1e-3)
    tolerance: Float[Array, ""] = eqx.field(converter=as_real, default=1e-4)

    def __check_init__(self):
        require_between("tick", self.tick, 1e-5, LONGEST_TICK, " s")
        require_between("zeta-step", self.zeta_step, 0.0, LARGEST_ZETA)
        require_between("tolerance", self.tolerance, 0.0, 1.0, " m")

    def begin(self, state: State, zeta: Float[Array, ""]) -> Memory:
        return ()

    def tune(
        self, memory: Memory, zeta: Float[Array, ""], error: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Memory]:
        # Comparisons with NaN are false: a tick without a measurement leaves zeta alone.
        up, down = error < -self.tolerance, error > self.tolerance
        step = jnp.where(up, self.zeta_step, jnp.where(down, -self.zeta_step, 0.0))
        # Eq. 7 has no bound; sand that pulls has no meaning.
        return jnp.maximum(zeta + step, 0.0), memory

    def follow(
        self, memory: Memory, advance: Advance, state: State, zeta: Float[Array, ""]
    ) -> tuple[State, Output, Memory]:
        return *advance(state, zeta), memory


class Loop(eqx.Module):
    """State of simulation and tuner between two ticks.

    Attributes:
        state: State of the simulated wheel.
        zeta: Scaling factor as last tuned [-].
        memory: Of the tuner; empty before `with_tuner_memory`.
    """

    state: State
    zeta: Float[Array, ""]
    memory: Memory = ()


class Tick(eqx.Module):
    """Output of a tick; with a leading time axis, of a run.

    Attributes:
        error: Recorded minus simulated sinkage at the tick's start [m]; NaN without a measurement.
        zeta: Scaling factor over the tick [-].
        output: Of the simulator, at the tick's end.
    """

    error: Float[Array, "*ticks"]
    zeta: Float[Array, "*ticks"]
    output: Output


def with_zeta_per_step(simulator: Simulator) -> Simulator:
    """The same simulator, prepared, with zeta taken from each step's command."""
    terrain = dataclasses.replace(simulator.terrain, zeta=PerStepZeta())
    return dataclasses.replace(simulator, terrain=terrain).prepared()


def with_tuner_memory(tuner: AbstractTuner, loop: Loop) -> Loop:
    """The loop as it is, or with the tuner's first memory where it has none."""
    if jax.tree.leaves(loop.memory):
        return loop
    return dataclasses.replace(loop, memory=tuner.begin(loop.state, loop.zeta))


def tuned_tick(
    simulator: Simulator,
    tuner: AbstractTuner,
    loop: Loop,
    commands: Command,
    recorded: Float[Array, ""],
) -> tuple[Loop, Tick]:
    """One tick: compare the sinkages, tune zeta, and simulate to the next tick.

    Args:
        simulator: One that takes zeta per step; see `with_zeta_per_step`.
        tuner: Law that changes zeta.
        loop: At the tick's start, with the tuner's memory; see `with_tuner_memory`.
        commands: One for each of the tick's steps, shape (substeps,); their zeta is not read.
        recorded: Newest sinkage known at the tick's start [m]; NaN where there is none.

    Returns:
        The loop at the tick's end, and the tick's output.
    """
    error = recorded + loop.state.position[1]
    zeta, memory = tuner.tune(loop.memory, loop.zeta, error)
    dt = tuner.tick / commands.omega.shape[0]

    def advance(state: State, zeta: Float[Array, ""]) -> tuple[State, Output]:
        def step(state: State, command: Command) -> tuple[State, Output]:
            return simulator.step(state, dataclasses.replace(command, zeta=zeta), dt)

        state, outputs = jax.lax.scan(step, state, commands)
        return state, jax.tree.map(lambda values: values[-1], outputs)

    state, output, memory = tuner.follow(memory, advance, loop.state, zeta)
    return Loop(state, zeta, memory), Tick(error, zeta, output)


def tick_commands(
    ticks: int,
    substeps: int,
    tick: Real,
    time: Float[Array, " knots"],
    omega: Float[Array, " knots"],
    vx: Float[Array, " knots"] | None = None,
) -> Command:
    """A recorded command for every step of every tick.

    Args:
        ticks, substeps: Number of ticks, and of steps in each.
        tick: Control period [s].
        time: Knots of the command from its first on [s], shape (knots,).
        omega: Commanded angular velocity [rad/s], shape (knots,).
        vx: Commanded carriage speed [m/s], shape (knots,); zero where none is given.

    Returns:
        Commands of shape (ticks, substeps).
    """
    times = step_times(ticks * substeps, as_real(tick) / substeps)
    commands = command_at(times, time, omega, vx)
    return jax.tree.map(lambda values: values.reshape(ticks, substeps), commands)
