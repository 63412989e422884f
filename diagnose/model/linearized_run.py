"""A simulated run and its linearisation: what any small unknown input would change.

The run is cut into nodes of about `NODE` seconds. At each node one step is differentiated by the
wheel's motion and by the inputs of `diagnose.model.unknown_inputs`; the node's map is that step's,
as often as it fits. From there every response to anything small is a matter of matrices.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diagnose.model.unknown_inputs import INPUTS, unknown_inputs
from drftjax.physics.command import Command, split_at_reversals
from drftjax.physics.state import State
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.trial import Trial

NODE = 0.01


# The motion that is linearised: x, z, vx, vz, angle; and what else is read: fx, fz, torque.
MOTION = 5


# Growth of a motion over a node that no wheel on sand shows.
LARGEST_GROWTH = 1.02


# Points in which a grouser's ripple is drawn.
RIPPLE_POINTS = 48


FORCES = ("fx", "fz", "torque")


class LinearizedRun(eqx.Module):
    """A run at its nodes, and the run's linear map from one to the next.

    Attributes:
        nodes: Number of true nodes; the rest are padding.
        dt: Integrator step [s].
        steps: Steps in a node.
        time: Node times [s], shape (nodes + 1,).
        motion: (x, z, vx, vz, angle) there, shape (nodes + 1, 5).
        omega: Angular velocity there [rad/s].
        middle_time, middle, middle_omega: Likewise in the middle of each node.
        forces: (fx, fz, torque) in the middle of a node, shape (nodes, 3).
        carry: Derivative of a node's end by its start, shape (nodes, 5, 5).
        gather: Sum of the powers of a step's map over a node: what a kick at every step becomes.
        enter: Derivative of one step by the inputs, shape (nodes, 5, inputs).
        forces_carry, forces_enter: Derivatives of the forces, shape (nodes, 3, ...).
        ripple: Derivative of the grousers' ripple of (x, z) by the wheel angle [m/rad], shape
            (nodes + 1, 2); see `steadied`.
    """

    nodes: Int[Array, ""]
    dt: Float[Array, ""]
    steps: Int[Array, ""]
    time: Float[Array, " all"]
    motion: Float[Array, "all 5"]
    omega: Float[Array, " all"]
    middle_time: Float[Array, " nodes"]
    middle_motion: Float[Array, "nodes 5"]
    middle_omega: Float[Array, " nodes"]
    forces: Float[Array, "nodes 3"]
    state_transition: Float[Array, "nodes 5 5"]
    substep_sum: Float[Array, "nodes 5 5"]
    input_matrix: Float[Array, "nodes 5 inputs"]
    force_by_state: Float[Array, "nodes 3 5"]
    force_by_input: Float[Array, "nodes 3 inputs"]
    ripple: Float[Array, "all 2"]


def state_of(
    motion: Float[Array, "5"], time: Float[Array, ""], omega: Float[Array, ""], memory=()
) -> State:
    """A state from its motion (x, z, vx, vz, angle)."""
    return State(time, motion[:2], motion[2:4], motion[4], omega, memory)


def motion_of(state: State) -> Float[Array, "5"]:
    """(x, z, vx, vz, angle) of a state."""
    return jnp.concatenate([state.position, state.velocity, state.angle[None]])


def command_at_time(trial: Trial, time: Float[Array, ""]) -> Command:
    """The trial's command at a time [s]."""
    omega = jnp.interp(time, trial.time, trial.omega)
    return Command(omega, jnp.interp(time, trial.time, trial.vx), jnp.zeros_like(omega))


def steps_per_node(trial: Trial) -> int:
    """Steps that make a node of about `NODE` seconds."""
    return max(1, round(NODE / float(trial.step)))


@eqx.filter_jit
def linearize(
    trial: Trial, steps: Int[Array, ""], nodes: Int[Array, ""], size: int
) -> LinearizedRun:
    """Simulate a run and linearise it.

    Args:
        trial: The run.
        steps: Steps in a node.
        nodes: Nodes to make.
        size: Room for nodes.
    """
    simulator: Simulator = trial.simulator.prepared()
    commands = trial.commands()
    room = commands.omega.shape[0]
    command = lambda k: jax.tree.map(lambda c: c[jnp.minimum(k, room - 1)], commands)  # noqa: E731
    state = simulator.remembered(trial.start, command(0))
    dt = trial.step

    def varied(motion, inputs, state, command):
        plus = replace(simulator, effects=simulator.effects + unknown_inputs(inputs))
        memory = (*state.memory, *((),) * 4)
        start = state_of(motion, state.time, state.omega + inputs[3], memory)
        after, output = plus.step(start, command, dt)
        return jnp.concatenate(
            [motion_of(after), jnp.stack([getattr(output, name) for name in FORCES])]
        )

    def advanced(number, state):
        return simulator.step(state, command(number), dt)[0]

    directions = jnp.eye(MOTION + len(INPUTS))

    def linearised(number, begun, within):
        """A node's row, from the state it begins with and the one in its middle."""
        middle = number * steps + steps // 2
        values, along = jax.linearize(
            lambda motion, inputs: varied(motion, inputs, within, command(middle)),
            motion_of(within),
            jnp.zeros(len(INPUTS)),
        )
        slopes = jax.vmap(along, out_axes=1)(directions[:, :MOTION], directions[:, MOTION:])
        carry, gather = _powers(slopes[:MOTION, :MOTION], steps)
        return (
            begun.time,
            motion_of(begun),
            begun.omega,
            within.time,
            motion_of(within),
            within.omega,
            values[MOTION:],
            carry,
            gather,
            slopes[:MOTION, MOTION:],
            slopes[MOTION:, :MOTION],
            slopes[MOTION:, MOTION:],
        )

    # By half nodes, so that the step stands in the program once.
    def half(count, carried):
        begun, table = carried
        number, second = count // 2, count % 2
        first = number * steps
        state = jax.lax.fori_loop(
            first + second * (steps // 2),
            first + jnp.where(second, steps, steps // 2),
            advanced,
            begun,
        )

        def kept(table):
            row = linearised(number, begun, state)
            return jax.tree.map(lambda t, r: t.at[number].set(r), table, row)

        return state, jax.lax.cond(second, lambda table: table, kept, table)

    inputs = len(INPUTS)
    shapes = [(), (5,), (), (), (5,), (), (3,), (5, 5), (5, 5), (5, inputs), (3, 5), (3, inputs)]
    table = tuple(jnp.zeros((size, *shape)) for shape in shapes)
    state, table = jax.lax.fori_loop(0, 2 * nodes, half, (state, table))
    time, motion, omega, *rest = table

    def ended(rows, last):
        return jnp.concatenate([rows, rows[-1:]]).at[nodes].set(last)

    return LinearizedRun(
        nodes,
        dt,
        steps,
        ended(time, state.time),
        ended(motion, motion_of(state)),
        ended(omega, state.omega),
        *rest,
        ripple=jnp.zeros((size + 1, 2)),
    )


def _powers(step: Float[Array, "5 5"], count: Int[Array, ""]):
    """The map of `count` equal steps, and the sum of the powers below it."""
    one = jnp.eye(MOTION)

    def again(_, both):
        power, total = both
        return step @ power, total + power

    return jax.lax.fori_loop(0, count, again, (one, jnp.zeros_like(one)))


def repair_outlier_maps(path: LinearizedRun, pitch: float) -> LinearizedRun:
    """The path made fit for sums over many nodes.

    Where a plate crosses a corner of the stress law just as a step is differentiated, the step's
    map is that corner's and no other step's: maps that grow are replaced by their nearest
    neighbours'. For the same reason no sum of derivatives by the wheel angle is right: the forces
    jump with it. The angle is therefore taken out of the maps, and what it does in the end is
    read off the run itself: it shifts the grousers' ripple along.

    Args:
        path: As traced.
        pitch: Angle between two grousers [rad]; infinite without any.
    """
    nodes = int(path.nodes)
    carry = np.array(path.state_transition)
    carry[:, :4, 4] = 0
    forces_carry = np.array(path.force_by_state)
    forces_carry[:, :, 4] = 0
    path = replace(
        path, state_transition=carry, force_by_state=forces_carry, ripple=_ripple(path, pitch)
    )
    moving = carry[:nodes, 1:4, 1:4]
    largest = np.abs(np.linalg.eigvals(np.where(np.isfinite(moving), moving, 1e9))).max(axis=1)
    good = np.flatnonzero(largest < LARGEST_GROWTH)
    if len(good) in (0, nodes):
        return path
    place = np.clip(np.searchsorted(good, np.arange(nodes)), 1, len(good) - 1)
    before, after = good[place - 1], good[place]
    number = np.arange(nodes)
    nearest = np.where(number - before <= after - number, before, after)
    index = np.r_[nearest, nodes : len(carry)]
    maps = (
        "state_transition",
        "substep_sum",
        "input_matrix",
        "force_by_state",
        "force_by_input",
    )
    return replace(path, **{name: getattr(path, name)[index] for name in maps})


def _ripple(path: LinearizedRun, pitch: float) -> np.ndarray:
    nodes = int(path.nodes)
    slope = np.zeros((path.motion.shape[0], 2))
    motion = np.asarray(path.motion)[: nodes + 1]
    turned = np.diff(motion[:, 4], append=motion[-1, 4])
    for part, sense in split_at_reversals(np.sign(np.where(np.abs(turned) > 1e-9, turned, 0))):
        slope[: nodes + 1][part] = _ripple_one_way(motion[part], pitch, sense)
    return slope


def _ripple_one_way(motion: np.ndarray, pitch: float, sense: int) -> np.ndarray:
    """Derivative of the ripple of (x, z) by the angle of a wheel that turns on, 1, or back, -1."""
    slope = np.zeros((len(motion), 2))
    angle = sense * motion[:, 4]
    if not np.isfinite(pitch) or angle[-1] - angle[0] < 2 * pitch:
        return slope
    moving = np.r_[True, np.diff(angle) > 1e-9]
    grid = np.arange(angle[0] - pitch, angle[-1] + pitch, pitch / RIPPLE_POINTS)
    for column in range(2):
        along = np.interp(grid, angle[moving], motion[moving, column])
        box = np.ones(RIPPLE_POINTS) / RIPPLE_POINTS
        ripple = along - np.convolve(along, box, mode="same")
        rate = np.gradient(ripple, grid)
        whole = (angle > angle[0] + pitch) & (angle < angle[-1] - pitch)
        slope[:, column] = np.where(whole, sense * np.interp(angle, grid, rate), 0)
    return slope
