r"""Derivative of a run's inputs, state and readings by the strengths of one effect, at every node.

An effect acts on some of the inputs of a linearised run (zeta, forces, speed, the surface's plane),
on a step as a whole (effects on plates), or on the readings. An incline acts by the height of its
plane, an input, and by its rise, by which a step is differentiated once for all of its shapes. The
equations are differentiated by each strength $\theta$ at zero, in forward mode, along the run as
simulated without the effect. That gives $\partial u_k/\partial\theta$,
$\partial m_k/\partial\theta$ (state at a step's end), $\partial f_k/\partial\theta$ (forces) and
$\partial y_k/\partial\theta$ (readings) at node k, which `propagate` sums up along the linearised
run to the response of the readings.
"""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diagnose.model.linearized_run import (
    FORCES,
    MOTION,
    LinearizedRun,
    command_at_time,
    motion_of,
    state_of,
)
from diagnose.model.shared_programs import Held
from diagnose.model.unknown_inputs import INPUTS
from drftjax.effects.base import (
    AbstractAdjustment,
    AbstractDrive,
    AbstractEffect,
    AbstractIncline,
    AbstractLoad,
    AbstractPlacement,
    AbstractPlane,
    AbstractSandLoad,
    AbstractSensor,
    AbstractStressFactor,
    AbstractSurface,
    AbstractZetaFactor,
    EffectInfo,
    StepContext,
    strength,
)
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.physics.state import Output
from drftjax.simulation.trial import Trial

# Values of an effect's shapes by name, one for each variant.
ShapeValues = dict[str, Float[Array, " variants"]]


class InputSensitivity(eqx.Module):
    """Forcing of a linearised run per unit of strength; columns are strengths of shape variants.

    Attributes:
        inputs: Derivative of the inputs, in the order of `INPUTS`, shape (nodes, inputs, columns).
        motion: Of (x, z, vx, vz, angle) at the end of one step [m, m/s, rad], shape (nodes, 5,
            columns).
        forces: Of the measured (fx, fz, torque) [N, N m], shape (nodes, 3, columns).
        readings: Of (x, z, fx, fz, torque) as read at the nodes' ends [m, N, N m], shape (nodes, 5,
            columns).
        start: Of the motion at the run's start, shape (1, 5, columns).
    """

    inputs: Float[Array, "nodes inputs columns"]
    motion: Float[Array, "nodes 5 columns"]
    forces: Float[Array, "nodes 3 columns"]
    readings: Float[Array, "nodes 5 columns"]
    start: Float[Array, "1 5 columns"]


READINGS = ("x", "z", "fx", "fz", "torque")


@eqx.filter_jit
def effect_sensitivity(
    effect: type[AbstractEffect],
    trial: Trial,
    linearized: LinearizedRun,
    node: Float[Array, ""],
    variants: ShapeValues,
    held: Held,
) -> InputSensitivity:
    """Derivatives along one run by an effect's strengths, for every variant of its shapes.

    Args:
        effect: The effect's class.
        trial: The run as it was linearised.
        linearized: The linearised run.
        node: Length of a node [s].
        variants: Values of the effect's shapes; may be empty.
        held: Numbers of the effect that no fit changes, by field.

    Returns:
        Derivatives per unit of each strength; columns go by variant, then by strength.
    """
    names = strengths(effect)
    at_null = jnp.zeros(len(names))
    by_rise = _by_rise(trial, linearized, node) if issubclass(effect, AbstractIncline) else None

    def of(values: ShapeValues):
        def along(strengths_: Array):
            built = effect(**dict(zip(names, strengths_, strict=True)), **values, **held)
            return _along(built, trial, linearized, node, by_rise)

        return jax.vmap(lambda d: jax.jvp(along, (at_null,), (d,))[1], out_axes=-1)(
            jnp.eye(len(names))
        )

    if not variants:
        return of({})
    found = jax.lax.map(of, variants)  # (variants, nodes, what, strengths)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 2).reshape(*leaf.shape[1:3], -1), found)


class _Rise(AbstractIncline):
    """A surface at the undisturbed height under the axle that rises along x."""

    about: ClassVar = EffectInfo("rise", "terrain", "h = h + rise ahead", "an inclined surface")
    rise: Float[Array, ""] = strength("-", 0.01, "rise of the surface along x")

    def plane(self, axle: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        return jnp.zeros_like(axle), self.rise


def _by_rise(trial: Trial, linearized: LinearizedRun, node: Float[Array, ""]) -> InputSensitivity:
    """Derivative of a step in each node, and of its forces, by the rise of an incline."""

    def with_rise(rise: Float[Array, ""]) -> InputSensitivity:
        return _through_a_step(_Rise(rise), trial, linearized, node)

    return jax.jvp(with_rise, (jnp.zeros(()),), (jnp.ones(()),))[1]


def _along(
    effect: AbstractEffect,
    trial: Trial,
    linearized: LinearizedRun,
    node: Float[Array, ""],
    by_rise: InputSensitivity | None,
) -> InputSensitivity:
    """Inputs, state and readings of the run with an effect, to be differentiated.

    `by_rise` is that of `_by_rise`, for an incline.
    """
    on_plates = isinstance(effect, AbstractAdjustment | AbstractPlacement | AbstractStressFactor)
    # A plane is an input of the run; any other surface is not.
    if on_plates or (isinstance(effect, AbstractSurface) and not isinstance(effect, AbstractPlane)):
        sensitivity = _through_a_step(effect, trial, linearized, node)
        read = slice(0, 2)  # the step reads forces itself
    else:
        sensitivity = _through_inputs(effect, trial, linearized, node, by_rise)
        read = slice(None)
    if isinstance(effect, AbstractSensor):
        readings = sensitivity.readings.at[:, read].set(
            _readings(effect, linearized, node)[:, read]
        )
        weight = -trial.simulator.rig.load(jnp.zeros(2))[1]
        start = linearized.motion[0].at[:2].set(effect.started(linearized.motion[0, :2], weight))
        sensitivity = replace(sensitivity, readings=readings, start=start[None])
    return sensitivity


def _through_inputs(
    effect: AbstractEffect,
    trial: Trial,
    linearized: LinearizedRun,
    node,
    by_rise: InputSensitivity | None,
) -> InputSensitivity:
    """The same of an effect that acts on inputs of the linearised run."""
    series: dict[str, Array] = {}
    motion = jnp.zeros((linearized.middle_time.shape[0], MOTION))
    read = jnp.zeros((linearized.middle_time.shape[0], len(FORCES)))
    if isinstance(effect, AbstractZetaFactor):
        series["zeta"] = _zeta(effect, trial, linearized, node)
    if isinstance(effect, AbstractPlane):
        series["height"], series["rise"] = _plane(effect, trial, linearized, node)
    if isinstance(effect, AbstractDrive):
        series["speed"] = _speed(effect, trial, linearized, node)
    if isinstance(effect, AbstractLoad):
        force = _force(effect, trial, linearized, node)
        series["force_x"], series["force_z"] = force[:, 0], force[:, 1]
        if isinstance(effect, AbstractSandLoad):
            read = read.at[:, :2].set(force)
    if isinstance(effect, AbstractIncline) and by_rise is not None:
        series["height"], rise = jax.vmap(effect.plane)(linearized.middle_motion[:, 0])
        motion, read = (
            motion + rise[:, None] * by_rise.motion,
            read + rise[:, None] * by_rise.forces,
        )
    return replace(_forced_inputs(linearized, **series), motion=motion, forces=read)


def _forced_inputs(linearized: LinearizedRun, **series: Float[Array, " nodes"]) -> InputSensitivity:
    """A forcing by some inputs alone, by their names in `INPUTS`."""
    zeros = jnp.zeros_like(linearized.middle_time)
    nodes = zeros.shape[0]
    return InputSensitivity(
        jnp.stack([series.get(name, zeros) for name in INPUTS], axis=1),
        jnp.zeros((nodes, MOTION)),
        jnp.zeros((nodes, len(FORCES))),
        jnp.zeros((nodes, len(READINGS))),
        jnp.zeros((1, MOTION)),
    )


def _contexts(trial: Trial, linearized: LinearizedRun, node: Float[Array, ""]) -> StepContext:
    """Context of an effect in the middle of each node, leaves of shape (nodes, ...)."""
    commanded = jax.vmap(lambda time: command_at_time(trial, time).omega)(linearized.middle_time)
    ones = jnp.ones_like(linearized.middle_time)
    return StepContext(
        linearized.middle_time,
        node * ones,
        linearized.middle_motion[:, :2],
        linearized.middle_motion[:, 2:4],
        linearized.middle_motion[:, 4],
        linearized.middle_omega,
        commanded,
        trial.simulator.wheel.radius * ones,
    )


def _zeta(
    effect: AbstractZetaFactor, trial: Trial, linearized: LinearizedRun, node
) -> Float[Array, " nodes"]:
    """Logarithm of the effect's factor on zeta, in the middle of each node."""

    def one(memory, context: StepContext):
        half = replace(context, dt=context.dt / 2)
        memory = effect.advance(memory, half)
        return effect.advance(memory, half), jnp.log(effect.factor(context, memory))

    return jax.lax.scan(one, effect.begin(), _contexts(trial, linearized, node))[1]


def _plane(
    effect: AbstractPlane, trial: Trial, linearized: LinearizedRun, node
) -> tuple[Array, Array]:
    """Height [m] and rise [-] of the surface under the axle, in the middle of each node."""

    def one(memory, context: StepContext):
        half = replace(context, dt=context.dt / 2)
        memory = effect.advance(memory, half)
        return effect.advance(memory, half), effect.plane(context.position[0], memory)

    return jax.lax.scan(one, effect.begin(), _contexts(trial, linearized, node))[1]


def _force(
    effect: AbstractLoad, trial: Trial, linearized: LinearizedRun, node
) -> Float[Array, "nodes 2"]:
    """Force on the axle [N], in the middle of each node."""

    def one(memory, context: StepContext):
        force = effect.load(context.position, context.velocity, context, memory)
        return effect.advance(memory, context), force

    return jax.lax.scan(
        one, effect.begin(linearized.motion[0, :2]), _contexts(trial, linearized, node)
    )[1]


def _speed(
    effect: AbstractDrive, trial: Trial, linearized: LinearizedRun, node
) -> Float[Array, " nodes"]:
    """Angular velocity of the wheel [rad/s], in the middle of each node."""
    contexts = _contexts(trial, linearized, node)

    def one(memory, context: StepContext):
        before = context.angle - node * context.commanded
        omega, memory = effect.turn(context.commanded, before, node, memory)
        return memory, omega

    return jax.lax.scan(one, effect.begin(linearized.omega[0], linearized.motion[0, 4]), contexts)[
        1
    ]


def _readings(effect: AbstractSensor, linearized: LinearizedRun, node) -> Float[Array, "nodes 5"]:
    """Readings (x, z, fx, fz, torque) at the nodes' ends [m, N, N m]."""

    def output(time, motion, omega, forces) -> Output:
        x, z, vx, vz, angle = motion
        fx, fz, torque = forces
        nought = jnp.zeros_like(time)
        return Output(time, x, z, vx, vz, angle, omega, fx, fz, torque, nought, -z, nought)

    ends = linearized.time[1:], linearized.motion[1:], linearized.omega[1:], linearized.forces

    def one(memory, row):
        reading, memory = effect.read(output(*row), node, memory)
        return memory, jnp.stack([getattr(reading, name) for name in READINGS])

    first = output(
        linearized.time[0], linearized.motion[0], linearized.omega[0], linearized.forces[0]
    )
    return jax.lax.scan(one, effect.begin(first), ends)[1]


def _through_a_step(
    effect: AbstractEffect, trial: Trial, linearized: LinearizedRun, node
) -> InputSensitivity:
    """End and forces of a step in the middle of each node, with the effect."""
    plain = trial.simulator
    simulator = replace(plain, effects=(*plain.effects, effect)).prepared()
    first = command_at_time(trial, linearized.time[0])
    memory = simulator.begin(
        state_of(linearized.motion[0], linearized.time[0], linearized.omega[0]), first
    ).memory

    def one(memory, row):
        time, motion, omega = row
        start = state_of(motion, time, omega, memory)
        after, output = simulator.step(
            start, command_at_time(trial, time + linearized.dt), linearized.dt
        )
        if jax.tree.leaves(memory):
            memory = simulator.step(start, command_at_time(trial, time + node), node)[0].memory
        return memory, (motion_of(after), jnp.stack([getattr(output, name) for name in FORCES]))

    rows = linearized.middle_time, linearized.middle_motion, linearized.middle_omega
    motion, forces = jax.lax.scan(one, memory, rows)[1]
    return replace(_forced_inputs(linearized), motion=motion, forces=forces)


@eqx.filter_jit
def propagate(
    linearized: LinearizedRun, sensitivity: InputSensitivity
) -> Float[Array, "all 5 columns"]:
    r"""Response of a run's readings to a forcing, at its nodes.

    With $u_k$, $m_k$, $f_k$, $y_k$ the columns of `sensitivity` and A, B, C, D, n of
    `diagnose.model.linearized_run`,

    $$s_{k+1} = A_k^n s_k + \Big(\sum_{i<n} A_k^i\Big)(B_k u_k + m_k),\qquad
      g_k = C_k s_k + D_k u_k + f_k,$$

    from $s_0$ = `sensitivity.start`. Position is read as $(x, z)_k$ of $s_k$, shifted by the
    grousers' ripple $\rho_k \varphi_k$, and everything by $y_k$.

    Args:
        linearized: The linearised run.
        sensitivity: The forcing.

    Returns:
        Change of (x, z, fx, fz, torque) at the node times per unit of each column [m, N, N m],
        shape (nodes + 1, 5, columns); zero at the start.
    """
    driven = (
        jnp.einsum("nij,njc->nic", linearized.input_matrix, sensitivity.inputs) + sensitivity.motion
    )
    driven = jnp.einsum("nij,njc->nic", linearized.substep_sum, driven)

    def one(motion, row):
        transition, drive, by_state, forces, ripple = row
        position = motion[:2] + ripple[:, None] * motion[4]
        return transition @ motion + drive, (position, by_state @ motion + forces)

    forcing = (
        jnp.einsum("nij,njc->nic", linearized.force_by_input, sensitivity.inputs)
        + sensitivity.forces
    )
    last, (position, forces) = jax.lax.scan(
        one,
        sensitivity.start[0],
        (
            linearized.state_transition,
            driven,
            linearized.force_by_state,
            forcing,
            linearized.ripple[:-1],
        ),
    )
    position = jnp.concatenate([position[1:], last[None, :2]])
    readings = jnp.concatenate([position, forces], axis=1) + sensitivity.readings
    return jnp.concatenate([jnp.zeros_like(readings[:1]), readings])


def zeta_sensitivity(linearized: LinearizedRun) -> InputSensitivity:
    """Sensitivity to the run's own log zeta, its only column."""
    ones = jnp.ones_like(linearized.middle_time)
    return jax.tree.map(lambda leaf: leaf[..., None], _forced_inputs(linearized, zeta=ones))


def shape_grid(effect: type[AbstractEffect]) -> ShapeValues:
    """Grid over an effect's shapes that covers the values a rig may show.

    Returns:
        By shape, its value in each variant, shape (variants,); empty for an effect without shapes.
    """
    about = field_metadata(effect)
    starts = [np.asarray(about[name]["starts"], float) for name in shapes(effect)]
    if not starts:
        return {}
    mesh = np.meshgrid(*starts, indexing="ij")
    return {name: jnp.asarray(m.ravel()) for name, m in zip(shapes(effect), mesh, strict=True)}
