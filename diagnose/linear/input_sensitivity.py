"""What an effect does to a simulated run at each of its nodes, per unit of each strength.

An effect changes either some of the inputs that a run is linearised by (zeta, forces, speed, the
surface's plane), or a step as a whole (what bears on plates), or the readings. Each is
differentiated along the run as simulated without it.
"""

from dataclasses import replace

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
    AbstractLoad,
    AbstractPlacement,
    AbstractPlane,
    AbstractSandLoad,
    AbstractSensor,
    AbstractStressFactor,
    AbstractSurface,
    AbstractZetaFactor,
    StepContext,
)
from drftjax.effects.catalogue import field_metadata, shapes, strengths
from drftjax.physics.state import Output
from drftjax.simulation.trial import Trial

ShapeValues = dict[str, Float[Array, " variants"]]


class InputSensitivity(eqx.Module):
    """Derivatives along a run by strengths and variants of shape, columns last.

    Attributes:
        inputs: Of the inputs, shape (nodes, inputs, columns).
        motion: Of a step's end, shape (nodes, 5, columns).
        forces: Of the forces read, shape (nodes, 3, columns).
        readings: Of (x, z, fx, fz, torque) as read at the nodes' ends, shape (nodes, 5, columns).
        start: Of the motion that the run starts with, shape (1, 5, columns).
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
    path: LinearizedRun,
    node: Float[Array, ""],
    variants: ShapeValues,
    held: Held,
) -> InputSensitivity:
    """Derivatives along one run by an effect's strengths, for every variant of its shapes.

    Args:
        effect: The effect's class.
        trial: The run as it was traced.
        path: Its trace.
        node: Length of a node [s].
        variants: Values of the effect's shapes; may be empty.
        held: Numbers of the effect that no fit changes, by field.

    Returns:
        Columns go by variant, then by strength.
    """
    names = strengths(effect)
    at_null = jnp.zeros(len(names))

    def of(values: ShapeValues):
        def along(strengths_: Array):
            built = effect(**dict(zip(names, strengths_, strict=True)), **values, **held)
            return _along(built, trial, path, node)

        return jax.vmap(lambda d: jax.jvp(along, (at_null,), (d,))[1], out_axes=-1)(
            jnp.eye(len(names))
        )

    if not variants:
        return of({})
    found = jax.lax.map(of, variants)  # (variants, nodes, what, strengths)
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 2).reshape(*leaf.shape[1:3], -1), found)


def _along(
    effect: AbstractEffect, trial: Trial, path: LinearizedRun, node: Float[Array, ""]
) -> InputSensitivity:
    on_plates = isinstance(effect, AbstractAdjustment | AbstractPlacement | AbstractStressFactor)
    # A plane is an input of the run; any other surface is not.
    if on_plates or (isinstance(effect, AbstractSurface) and not isinstance(effect, AbstractPlane)):
        kick, read = _of_a_step(effect, trial, path, node), slice(0, 2)  # forces are read in it
    else:
        kick, read = _of_its_inputs(effect, trial, path, node), slice(None)
    if isinstance(effect, AbstractSensor):
        readings = kick.readings.at[:, read].set(_readings(effect, path, node)[:, read])
        start = path.motion[0].at[:2].set(effect.started(path.motion[0, :2]))
        kick = replace(kick, readings=readings, start=start[None])
    return kick


def _of_its_inputs(
    effect: AbstractEffect, trial: Trial, path: LinearizedRun, node
) -> InputSensitivity:
    series: dict[str, Array] = {}
    read = jnp.zeros((path.middle_time.shape[0], len(FORCES)))
    if isinstance(effect, AbstractZetaFactor):
        series["zeta"] = _zeta(effect, trial, path, node)
    if isinstance(effect, AbstractPlane):
        series["height"], series["rise"] = _plane(effect, trial, path, node)
    if isinstance(effect, AbstractDrive):
        series["speed"] = _speed(effect, trial, path, node)
    if isinstance(effect, AbstractLoad):
        force = _force(effect, trial, path, node)
        series["force_x"], series["force_z"] = force[:, 0], force[:, 1]
        if isinstance(effect, AbstractSandLoad):
            read = read.at[:, :2].set(force)
    return replace(_of_inputs(path, **series), forces=read)


def _of_inputs(path: LinearizedRun, **series: Float[Array, " nodes"]) -> InputSensitivity:
    nothing = jnp.zeros_like(path.middle_time)
    nodes = nothing.shape[0]
    return InputSensitivity(
        jnp.stack([series.get(name, nothing) for name in INPUTS], axis=1),
        jnp.zeros((nodes, MOTION)),
        jnp.zeros((nodes, len(FORCES))),
        jnp.zeros((nodes, len(READINGS))),
        jnp.zeros((1, MOTION)),
    )


def _moments(trial: Trial, path: LinearizedRun, node: Float[Array, ""]) -> StepContext:
    """What an effect may know in the middle of each node, nodes leading."""
    commanded = jax.vmap(lambda time: command_at_time(trial, time).omega)(path.middle_time)
    alike = jnp.ones_like(path.middle_time)
    return StepContext(
        path.middle_time,
        node * alike,
        path.middle_motion[:, :2],
        path.middle_motion[:, 2:4],
        path.middle_motion[:, 4],
        path.middle_omega,
        commanded,
        trial.simulator.wheel.radius * alike,
    )


def _zeta(
    effect: AbstractZetaFactor, trial: Trial, path: LinearizedRun, node
) -> Float[Array, " nodes"]:
    def one(memory, moment: StepContext):
        half = replace(moment, dt=moment.dt / 2)
        memory = effect.advance(memory, half)
        return effect.advance(memory, half), jnp.log(effect.factor(moment, memory))

    return jax.lax.scan(one, effect.begin(), _moments(trial, path, node))[1]


def _plane(effect: AbstractPlane, trial: Trial, path: LinearizedRun, node) -> tuple[Array, Array]:
    def one(memory, moment: StepContext):
        half = replace(moment, dt=moment.dt / 2)
        memory = effect.advance(memory, half)
        return effect.advance(memory, half), effect.plane(moment.position[0], memory)

    return jax.lax.scan(one, effect.begin(), _moments(trial, path, node))[1]


def _force(
    effect: AbstractLoad, trial: Trial, path: LinearizedRun, node
) -> Float[Array, "nodes 2"]:
    def one(memory, moment: StepContext):
        force = effect.load(moment.position, moment.velocity, moment, memory)
        return effect.advance(memory, moment), force

    return jax.lax.scan(one, effect.begin(path.motion[0, :2]), _moments(trial, path, node))[1]


def _speed(
    effect: AbstractDrive, trial: Trial, path: LinearizedRun, node
) -> Float[Array, " nodes"]:
    moments = _moments(trial, path, node)

    def one(memory, moment: StepContext):
        before = moment.angle - node * moment.commanded
        omega, memory = effect.turn(moment.commanded, before, node, memory)
        return memory, omega

    return jax.lax.scan(one, effect.begin(path.omega[0], path.motion[0, 4]), moments)[1]


def _readings(effect: AbstractSensor, path: LinearizedRun, node) -> Float[Array, "nodes 5"]:
    def output(time, motion, omega, forces) -> Output:
        x, z, vx, vz, angle = motion
        fx, fz, torque = forces
        nought = jnp.zeros_like(time)
        return Output(time, x, z, vx, vz, angle, omega, fx, fz, torque, nought, -z, nought)

    ends = path.time[1:], path.motion[1:], path.omega[1:], path.forces

    def one(memory, row):
        reading, memory = effect.read(output(*row), node, memory)
        return memory, jnp.stack([getattr(reading, name) for name in READINGS])

    first = output(path.time[0], path.motion[0], path.omega[0], path.forces[0])
    return jax.lax.scan(one, effect.begin(first), ends)[1]


def _of_a_step(effect: AbstractEffect, trial: Trial, path: LinearizedRun, node) -> InputSensitivity:
    """What a step in the middle of each node ends at with the effect."""
    plain = trial.simulator
    simulator = replace(plain, effects=(*plain.effects, effect)).prepared()
    first = command_at_time(trial, path.time[0])
    memory = simulator.begin(state_of(path.motion[0], path.time[0], path.omega[0]), first).memory

    def one(memory, row):
        time, motion, omega = row
        start = state_of(motion, time, omega, memory)
        after, output = simulator.step(start, command_at_time(trial, time + path.dt), path.dt)
        memory = simulator.step(start, command_at_time(trial, time + node), node)[0].memory
        return memory, (motion_of(after), jnp.stack([getattr(output, name) for name in FORCES]))

    rows = path.middle_time, path.middle_motion, path.middle_omega
    motion, forces = jax.lax.scan(one, memory, rows)[1]
    return replace(_of_inputs(path), motion=motion, forces=forces)


@eqx.filter_jit
def propagate(path: LinearizedRun, kick: InputSensitivity) -> Float[Array, "all 5 columns"]:
    """What a run's readings (x, z, fx, fz, torque) become at its nodes, per unit of each column."""
    driven = jnp.einsum("nij,njc->nic", path.input_matrix, kick.inputs) + kick.motion
    driven = jnp.einsum("nij,njc->nic", path.substep_sum, driven)

    def one(motion, row):
        carry, drive, see, forces, ripple = row
        place = motion[:2] + ripple[:, None] * motion[4]
        return carry @ motion + drive, (place, see @ motion + forces)

    seen = jnp.einsum("nij,njc->nic", path.force_by_input, kick.inputs) + kick.forces
    last, (place, forces) = jax.lax.scan(
        one,
        kick.start[0],
        (path.state_transition, driven, path.force_by_state, seen, path.ripple[:-1]),
    )
    place = jnp.concatenate([place[1:], last[None, :2]])
    readings = jnp.concatenate([place, forces], axis=1) + kick.readings
    return jnp.concatenate([jnp.zeros_like(readings[:1]), readings])


def zeta_sensitivity(path: LinearizedRun) -> InputSensitivity:
    """The run's own log zeta as the only column."""
    alike = jnp.ones_like(path.middle_time)
    return jax.tree.map(lambda leaf: leaf[..., None], _of_inputs(path, zeta=alike))


def shape_grid(effect: type[AbstractEffect]) -> ShapeValues:
    """Values of an effect's shapes that together cover what a rig may show."""
    about = field_metadata(effect)
    starts = [np.asarray(about[name]["starts"], float) for name in shapes(effect)]
    if not starts:
        return {}
    mesh = np.meshgrid(*starts, indexing="ij")
    return {name: jnp.asarray(m.ravel()) for name, m in zip(shapes(effect), mesh, strict=True)}
