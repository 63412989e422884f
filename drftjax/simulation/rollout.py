"""Rollout of a whole run: the simulator's step scanned over a command."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from drftjax.common.arrays import Real, as_real
from drftjax.physics.command import Command
from drftjax.physics.state import Output, State
from drftjax.simulation.simulator import Simulator


def simulate(
    simulator: Simulator,
    state: State,
    commands: Command,
    dt: Float[Array, ""] | float,
    *,
    every: int = 1,
) -> tuple[State, Output]:
    """Scan `simulator.step` over `commands`.

    Differentiable forward and backward. Backward, only the states between the rows kept are
    stored and the steps in between are computed again, so memory stays small over long runs.

    Args:
        simulator: Every number of wheel, terrain and rig.
        state: State at the start.
        commands: One command for each step, shape (steps,); see `command_at`.
        dt: Step [s].
        every: Rows kept: each `every`-th step. Steps beyond the last whole row are not made.

    Returns:
        The state at the end, and the output at the end of each row, shape (steps // every,).
    """
    simulator = simulator.prepared()
    state = simulator.remembered(state, jax.tree.map(lambda c: c[0], commands))
    rows = commands.omega.shape[0] // every
    blocks = jax.tree.map(lambda c: c[: rows * every].reshape(rows, every, *c.shape[1:]), commands)

    def advance(both: tuple[State, Output], command: Command) -> tuple[tuple[State, Output], None]:
        return simulator.step(both[0], command, dt), None

    # The step stands in the program once: its compilation is most of what a short run costs.
    @jax.checkpoint
    def row(state: State, block: Command) -> tuple[State, Output]:
        nothing = Output(*(jnp.zeros_like(state.time) for _ in dataclasses.fields(Output)))
        return jax.lax.scan(advance, (state, nothing), block)[0]

    return jax.lax.scan(row, state, blocks)


def sweep(
    simulator: Simulator,
    state: State,
    command: Callable[[Float[Array, ""]], Command],
    interval: Float[Array, ""],
    parts: Int[Array, ""],
    rows: Int[Array, ""],
    room: int,
    keep: Callable[[Output], Float[Array, " kept"]],
) -> Float[Array, "kept all_rows"]:
    """As `simulate`, for numbers of rows and steps known at run time; differentiable forward only.

    Runs of any length and step share one compiled program, and none pays for another's.

    Args:
        simulator: Every number of wheel, terrain and rig.
        state: State at the start.
        command: Command at a time [s].
        interval: Time between rows [s].
        parts: Steps that an interval is made in.
        rows: Rows to make, at most `room`.
        room: Rows that the table has room for (static).
        keep: Values kept of each row, shape (kept,).

    Returns:
        The values kept, with the state at the start as a first row and zero beyond `rows`, shape
        (kept, room + 1).
    """
    simulator = simulator.prepared()
    interval = jnp.asarray(interval)
    first = command(jnp.zeros_like(interval))
    state = simulator.remembered(state, first)
    begun = keep(simulator.observe(state, first))
    table = jnp.zeros((room + 1, begun.shape[0]), begun.dtype).at[0].set(begun)
    dt = interval / parts.astype(interval.dtype)

    def step(number: Int[Array, ""], both: tuple[State, Array]) -> tuple[State, Array]:
        state, output = simulator.step(both[0], command((number + 1).astype(dt.dtype) * dt), dt)
        return state, keep(output)

    # The step stands in the program once: its compilation is most of what a short run costs.
    def row(number: Int[Array, ""], carried: tuple[State, Array]) -> tuple[State, Array]:
        state, table = carried
        both = jax.lax.fori_loop(number * parts, (number + 1) * parts, step, (state, begun))
        return both[0], table.at[number + 1].set(both[1])

    return jax.lax.fori_loop(0, rows, row, (state, table))[1].T


def with_first_row(simulator: Simulator, state: State, command: Command, rows: Output) -> Output:
    """Output of a run with the state at its start as a first row, shape (1 + rows,)."""
    first = simulator.observe(simulator.remembered(state, command), command)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rows)


def step_times(steps: int, dt: Real) -> Float[Array, " steps"]:
    """Ends of the first `steps` steps of `dt` [s], shape (steps,)."""
    return as_real(np.arange(1, steps + 1)) * dt
