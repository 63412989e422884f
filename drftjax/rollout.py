"""A whole run: the simulator's step scanned over a command."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from drftjax.arrays import Real, as_real
from drftjax.command import Command
from drftjax.simulator import Output, Simulator, State


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
    rows = commands.omega.shape[0] // every
    blocks = jax.tree.map(lambda c: c[: rows * every].reshape(rows, every, *c.shape[1:]), commands)

    @jax.checkpoint
    def row(state: State, block: Command) -> tuple[State, Output]:
        head = jax.tree.map(lambda c: c[:-1], block)
        last = jax.tree.map(lambda c: c[-1], block)

        def advance(state: State, command: Command) -> tuple[State, None]:
            return simulator.step(state, command, dt)[0], None

        state, _ = jax.lax.scan(advance, state, head)
        return simulator.step(state, last, dt)

    return jax.lax.scan(row, state, blocks)


def with_first_row(simulator: Simulator, state: State, command: Command, rows: Output) -> Output:
    """`rows` with the state they started from as a first row."""
    first = simulator.observe(state, command)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rows)


def step_times(steps: int, dt: Real) -> Float[Array, " steps"]:
    """Ends of the first `steps` steps of `dt` [s]."""
    return as_real(np.arange(1, steps + 1)) * dt
