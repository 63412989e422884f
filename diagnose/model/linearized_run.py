r"""A simulated run and its linearisation: a linear time-varying model along one run.

The run is divided into nodes of n steps, about `LinearizationSettings.node_time` long. In the
middle of each node one integrator step $s' = F(s, u)$, with sand forces $f = G(s, u)$, is
differentiated by the state $s = (x, z, v_x, v_z, \varphi)$ and by the inputs $u$ of
`diagnose.model.unknown_inputs`:

$$A = \partial F/\partial s,\quad B = \partial F/\partial u,\quad
  C = \partial G/\partial s,\quad D = \partial G/\partial u.$$

A node repeats that step n times. With small inputs $\delta u_k$ that are constant over node k,

$$\delta s_{k+1} = A_k^n\,\delta s_k + \Big(\sum_{i<n} A_k^i\Big) B_k\,\delta u_k,\qquad
  \delta f_k = C_k\,\delta s_k + D_k\,\delta u_k,$$

so the response to anything small is a product of matrices.
"""

from dataclasses import dataclass, replace

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

# Length of the state that is linearised: x, z, vx, vz, angle.
MOTION = 5


# What else is linearised.
FORCES = ("fx", "fz", "torque")


@dataclass(frozen=True)
class LinearizationSettings:
    """Numbers by which a run is linearised.

    Attributes:
        node_time: Length of a node, within which one step's derivative holds [s].
        ripple_points: Points per grouser at which the ripple of (x, z) is sampled.
        max_growth: Factor by which a small change of the motion grows over a node, at most [-].
            Ordinary nodes have 1, by x and the angle, on which nothing depends.
    """

    node_time: float = 0.01
    ripple_points: int = 48
    max_growth: float = 1.05


DEFAULT_LINEARIZATION = LinearizationSettings()


class LinearizedRun(eqx.Module):
    r"""A run at its nodes, and the linear map from each node to the next.

    Rows past `nodes` are padding.

    Attributes:
        nodes: Number of nodes K.
        dt: Integrator step [s].
        steps: Steps in a node, n.
        time: Node times [s], shape (K + 1,).
        motion: (x, z, vx, vz, angle) there [m, m/s, rad], shape (K + 1, 5).
        omega: Angular velocity there [rad/s], shape (K + 1,).
        middle_time, middle_motion, middle_omega: Likewise in the middle of each node.
        forces: (fx, fz, torque) in the middle of each node [N, N m], shape (K, 3).
        state_transition: $A^n$, derivative of a node's end by its start, shape (K, 5, 5).
        substep_sum: $\sum_{i<n} A^i$: maps a forcing that is constant over a node to the state at
            its end, shape (K, 5, 5).
        input_matrix: $B$, derivative of one step by the inputs, shape (K, 5, inputs).
        force_by_state: $C$, derivative of the forces by the state, shape (K, 3, 5).
        force_by_input: $D$, derivative of the forces by the inputs, shape (K, 3, inputs).
        ripple: Derivative of the grousers' ripple of (x, z) by the wheel angle [m/rad], shape
            (K + 1, 2); zero until `with_ripple`.
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

    @property
    def node_interval(self) -> float:
        """Length of a node [s]."""
        return float(self.dt) * int(self.steps)


def state_of(
    motion: Float[Array, "5"], time: Float[Array, ""], omega: Float[Array, ""], memory=()
) -> State:
    """A state from its motion (x, z, vx, vz, angle)."""
    return State(time, motion[:2], motion[2:4], motion[4], omega, memory)


def motion_of(state: State) -> Float[Array, "5"]:
    """Motion (x, z, vx, vz, angle) of a state."""
    return jnp.concatenate([state.position, state.velocity, state.angle[None]])


def command_at_time(trial: Trial, time: Float[Array, ""]) -> Command:
    """The trial's command at a time [s]."""
    omega = jnp.interp(time, trial.time, trial.omega)
    return Command(omega, jnp.interp(time, trial.time, trial.vx), jnp.zeros_like(omega))


def steps_per_node(trial: Trial, node_time: float = DEFAULT_LINEARIZATION.node_time) -> int:
    """Integrator steps that come closest to `node_time` [s]."""
    return max(1, round(node_time / float(trial.step)))


@eqx.filter_jit
def linearize(
    trial: Trial, steps: Int[Array, ""], nodes: Int[Array, ""], size: int
) -> LinearizedRun:
    """Simulate a run and linearise it at every node, without ripple.

    Args:
        trial: The run.
        steps: Steps in a node.
        nodes: Number of nodes.
        size: Number of nodes that arrays have room for (static).
    """
    simulator: Simulator = trial.simulator.prepared()
    commands = trial.commands()
    room = commands.omega.shape[0]
    dt = trial.step

    def command(step):
        return jax.tree.map(lambda c: c[jnp.minimum(step, room - 1)], commands)

    # By half nodes, so that the step stands in the program once.
    def half(count, carried):
        begun, table = carried
        number, second = count // 2, count % 2
        first = number * steps
        state = jax.lax.fori_loop(
            first + second * (steps // 2),
            first + jnp.where(second, steps, steps // 2),
            lambda step, state: simulator.step(state, command(step), dt)[0],
            begun,
        )

        def at_middle(_):
            middle = command(first + steps // 2)
            return _node_row(simulator, begun, state, middle, dt, steps)

        # Only the row passes through the branch, which would copy the whole table each time.
        written = jax.tree.map(lambda column: column[number], table)
        row = jax.lax.cond(second, lambda same: same, at_middle, written)
        return state, jax.tree.map(lambda t, r: t.at[number].set(r), table, row)

    inputs = len(INPUTS)
    shapes = [(), (5,), (), (), (5,), (), (3,), (5, 5), (5, 5), (5, inputs), (3, 5), (3, inputs)]
    table = tuple(jnp.zeros((size, *shape)) for shape in shapes)
    start = simulator.remembered(trial.start, command(0))
    state, table = jax.lax.fori_loop(0, 2 * nodes, half, (start, table))
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


def _node_row(
    simulator: Simulator,
    begun: State,
    middle: State,
    command: Command,
    dt: Float[Array, ""],
    steps: Int[Array, ""],
) -> tuple[Array, ...]:
    """A node's row of the table, in the order of `LinearizedRun`'s fields.

    Args:
        simulator: Of the run.
        begun, middle: State at the node's start and in its middle.
        command: In its middle.
        dt: Integrator step [s].
        steps: Steps in a node.
    """

    def step(motion, inputs):
        plus = replace(simulator, effects=simulator.effects + unknown_inputs(inputs))
        memory = (*middle.memory, *((),) * 4)
        start = state_of(motion, middle.time, middle.omega + inputs[3], memory)
        after, output = plus.step(start, command, dt)
        return jnp.concatenate(
            [motion_of(after), jnp.stack([getattr(output, name) for name in FORCES])]
        )

    values, along = jax.linearize(step, motion_of(middle), jnp.zeros(len(INPUTS)))
    directions = jnp.eye(MOTION + len(INPUTS))
    slopes = jax.vmap(along, out_axes=1)(directions[:, :MOTION], directions[:, MOTION:])
    transition, substep_sum = _powers(slopes[:MOTION, :MOTION], steps)
    return (
        begun.time,
        motion_of(begun),
        begun.omega,
        middle.time,
        motion_of(middle),
        middle.omega,
        values[MOTION:],
        transition,
        substep_sum,
        slopes[:MOTION, MOTION:],
        slopes[MOTION:, :MOTION],
        slopes[MOTION:, MOTION:],
    )


def _powers(
    step: Float[Array, "5 5"], count: Int[Array, ""]
) -> tuple[Float[Array, "5 5"], Float[Array, "5 5"]]:
    r"""$A^n$ and $\sum_{i<n} A^i$ of a step's map A, for n = `count`."""
    one = jnp.eye(MOTION)

    def multiply(_, both):
        power, total = both
        return step @ power, total + power

    return jax.lax.fori_loop(0, count, multiply, (one, jnp.zeros_like(one)))


# What holds in the middle of a node.
OF_THE_MIDDLE = (
    "middle_motion",
    "middle_omega",
    "forces",
    "state_transition",
    "substep_sum",
    "input_matrix",
    "force_by_state",
    "force_by_input",
)


def without_growth(
    linearized: LinearizedRun, settings: LinearizationSettings = DEFAULT_LINEARIZATION
) -> LinearizedRun:
    """A linearised run without the nodes over which a small change of the motion grows.

    Where a wheel breaks loose, the sand's force falls with its speed. For some hundredths of a
    second a small change grows, up to 30 times in each node, until the force rises again: the
    product of such maps holds for no change that could be seen. These nodes have the maps of the
    last one before them.

    Args:
        linearized: By `linearize`.
        settings: The greatest growth.
    """
    transition = np.asarray(linearized.state_transition)
    nodes = np.arange(len(transition))
    known = (nodes < int(linearized.nodes)) & np.isfinite(transition).all(axis=(1, 2))
    growth = np.zeros(len(nodes))
    growth[known] = np.abs(np.linalg.eigvals(transition[known])).max(axis=1)
    grows = growth > settings.max_growth
    if not grows.any() or grows[known].all():
        return linearized
    first = int(np.argmin(grows))
    source = np.maximum.accumulate(np.where(grows, first, nodes))
    rows = {name: np.asarray(getattr(linearized, name))[source] for name in OF_THE_MIDDLE}
    return replace(linearized, **rows)


def with_ripple(
    linearized: LinearizedRun,
    pitch: float,
    settings: LinearizationSettings = DEFAULT_LINEARIZATION,
) -> LinearizedRun:
    """A linearised run whose wheel angle acts by the grousers' ripple alone.

    Forces jump with the wheel angle where a plate crosses a corner of the stress law, so that no
    sum of derivatives by the angle is right. The angle is taken out of the maps, and its effect in
    the end is read off the run itself: it shifts the ripple along.

    Args:
        linearized: By `linearize`.
        pitch: Angle between two grousers [rad]; infinite without any.
        settings: Points of the ripple.
    """
    transition = np.array(linearized.state_transition)
    transition[:, :4, 4] = 0
    force_by_state = np.array(linearized.force_by_state)
    force_by_state[:, :, 4] = 0
    return replace(
        linearized,
        state_transition=transition,
        force_by_state=force_by_state,
        ripple=_ripple_slope(linearized, pitch, settings.ripple_points),
    )


def _ripple_slope(linearized: LinearizedRun, pitch: float, points: int) -> np.ndarray:
    """Derivative of the ripple of (x, z) by the wheel angle [m/rad], shape (size + 1, 2)."""
    nodes = int(linearized.nodes)
    slope = np.zeros((linearized.motion.shape[0], 2))
    motion = np.asarray(linearized.motion)[: nodes + 1]
    turned = np.diff(motion[:, 4], append=motion[-1, 4])
    for part, sense in split_at_reversals(np.sign(np.where(np.abs(turned) > 1e-9, turned, 0))):
        slope[: nodes + 1][part] = _ripple_slope_one_way(motion[part], pitch, sense, points)
    return slope


def _ripple_slope_one_way(motion: np.ndarray, pitch: float, sense: int, points: int) -> np.ndarray:
    """The same while the wheel turns forward (`sense` 1) or backward (-1).

    The ripple is what remains of (x, z) over the angle beyond its mean over one pitch; the first
    and the last pitch, which such a mean does not cover, have none.
    """
    slope = np.zeros((len(motion), 2))
    angle = sense * motion[:, 4]
    if not np.isfinite(pitch) or angle[-1] - angle[0] < 2 * pitch:
        return slope
    moving = np.r_[True, np.diff(angle) > 1e-9]
    grid = np.arange(angle[0] - pitch, angle[-1] + pitch, pitch / points)
    whole = (angle > angle[0] + pitch) & (angle < angle[-1] - pitch)
    for column in range(2):
        along = np.interp(grid, angle[moving], motion[moving, column])
        ripple = along - np.convolve(along, np.ones(points) / points, mode="same")
        rate = np.gradient(ripple, grid)
        slope[:, column] = np.where(whole, sense * np.interp(angle, grid, rate), 0)
    return slope
