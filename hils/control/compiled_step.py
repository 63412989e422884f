"""One tick of the loop's physics, compiled ahead of time, on one packed array of float64.

The very tick that a recorded run is replayed with offline (`drftjax.tuning.step_tuner.tuned_tick`):
compare the sinkages, tune zeta, simulate to the next tick. Packed, because every array that crosses
between Python and XLA costs more than all the plates of a wheel.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.state import State
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import vertical_support
from drftjax.tuning.step_tuner import (
    AbstractTuner,
    Loop,
    tuned_tick,
    with_tuner_memory,
    with_zeta_per_step,
)

Packed = NDArray[np.float64]


NO_READING = float("nan")


class StepResult(NamedTuple):
    """Outcome of a tick, as plain numbers.

    Attributes:
        error: Measured minus simulated sinkage at the tick's start [m]; NaN without a reading.
        zeta: Scaling factor over the tick [-].
        x, z: Simulated axle position at the tick's end [m].
        vx: Simulated speed there, which drives the carriage [m/s].
        fx, fz: Force of the sand on the simulated wheel [N].
        slip: Of the simulated wheel [-].
    """

    error: float
    zeta: float
    x: float
    z: float
    vx: float
    fx: float
    fz: float
    slip: float


NUMBERS = len(StepResult._fields)


_ZETA = StepResult._fields.index("zeta")


class CompiledStep:
    """A tick as one call: packed state in, packed state out. It holds no state of a run.

    Args:
        simulator: Every number of wheel, terrain and rig; its own zeta is not used.
        tuner: Rule that moves zeta, and the tick [s].
        substeps: Integrator steps in a tick.

    Raises:
        InputError: where JAX is not set to float64, without which no replay is exact.
    """

    def __init__(self, simulator: Simulator, tuner: AbstractTuner, substeps: int):
        if not jax.config.values["jax_enable_x64"]:
            raise InputError("the loop computes in float64; set jax_enable_x64 before it is built")
        self.tick = float(tuner.tick)
        self.substeps = substeps
        simulator = with_zeta_per_step(simulator)

        def start(state: State, zeta: Float[Array, ""]) -> Loop:
            still = jnp.zeros_like(zeta)
            state = simulator.remembered(state, Command(still, still, zeta))
            return with_tuner_memory(tuner, Loop(state, zeta))

        example = start(State.at_rest(0.01), as_real(1.0))
        leaves, tree = jax.tree.flatten(example)
        shapes = [leaf.shape for leaf in leaves]
        kinds = [leaf.dtype for leaf in leaves]
        ends = np.cumsum([leaf.size for leaf in leaves])[:-1]

        def pack(loop: Loop, numbers: Float[Array, " numbers"]) -> Float[Array, " packed"]:
            flat = [jnp.ravel(leaf).astype(float) for leaf in jax.tree.leaves(loop)]
            return jnp.concatenate([numbers, *flat])

        def unpack(packed: Float[Array, " packed"]) -> Loop:
            parts = jnp.split(packed[NUMBERS:], ends)
            built = zip(parts, shapes, kinds, strict=True)
            return jax.tree.unflatten(tree, [p.reshape(s).astype(k) for p, s, k in built])

        def first(sinkage, zeta, x, angle):
            loop = start(State.at_rest(sinkage, x, angle), zeta)
            nought = jnp.zeros_like(zeta)
            position = loop.state.position
            # No step is behind it yet; the sand bears it all the same.
            support = vertical_support(simulator, sinkage, zeta, angle)
            numbers = [nought, zeta, position[0], position[1], nought, nought, support, nought]
            return pack(loop, jnp.stack(numbers))

        def tick(packed: Float[Array, " packed"], given: Float[Array, " given"]):
            still = jnp.zeros_like(given[1:])
            commands = Command(given[1:], still, still)
            loop, said = tuned_tick(simulator, tuner, unpack(packed), commands, given[0])
            out = said.output
            numbers = [said.error, said.zeta, out.x, out.z, out.vx, out.fx, out.fz, out.slip]
            return pack(loop, jnp.stack(numbers))

        one = jax.ShapeDtypeStruct((), np.float64)
        length = NUMBERS + sum(leaf.size for leaf in leaves)
        self._tuner_at = NUMBERS + sum(leaf.size for leaf in jax.tree.leaves(example.state))
        packed = jax.ShapeDtypeStruct((length,), np.float64)
        given = jax.ShapeDtypeStruct((1 + substeps,), np.float64)
        self._first = jax.jit(first).lower(one, one, one, one).compile()
        self._tick = jax.jit(tick).lower(packed, given).compile()

    def begin(self, sinkage: float, zeta: float, x: float = 0.0, angle: float = 0.0) -> Packed:
        """Pack the state of a wheel at rest.

        Args:
            sinkage: H = -z [m].
            zeta: Scaling factor at the start [-].
            x: Position of the axle [m].
            angle: Wheel angle [rad].
        """
        given = (np.float64(value) for value in (sinkage, zeta, x, angle))
        return np.array(self._first(*given))

    def __call__(self, packed: Packed, sinkage: float, omega: NDArray[np.float64]) -> Packed:
        """Step to the tick's end; the packed state given stays as it is.

        Args:
            packed: At the tick's start.
            sinkage: Measured sinkage [m], or `NO_READING`, which holds zeta.
            omega: Commanded angular velocity at the end of each substep [rad/s].
        """
        given = np.empty(1 + self.substeps)
        given[0], given[1:] = sinkage, omega
        # A copy of a few dozen numbers: JAX's own memory may go to the next call's result.
        return np.array(self._tick(packed, given))

    def with_tuner_of(self, packed: Packed, earlier: Packed) -> Packed:
        """The simulated wheel of one packed state, with zeta and the tuner's memory of another."""
        mixed = packed.copy()
        mixed[_ZETA] = earlier[_ZETA]
        mixed[self._tuner_at :] = earlier[self._tuner_at :]
        return mixed

    def with_zeta(self, packed: Packed, zeta: float) -> Packed:
        """The packed state with another zeta [-]."""
        changed = packed.copy()
        changed[_ZETA] = changed[self._tuner_at] = zeta
        return changed

    @staticmethod
    def compute(packed: Packed) -> StepResult:
        """Outcome of the tick that ended in this state."""
        return StepResult(*packed[:NUMBERS].tolist())
