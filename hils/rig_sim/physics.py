"""The virtual rig's sand and wheel: a `Simulator` of its own, moved on in blocks of whole steps.

Apart from the loop's: finer plates, a shorter step, effects that the loop does not know, and a
carriage that a command's flag sets free or drives. Before its release the wheel hangs at
touch-down; it is then let down on a damper, slowly enough that it stands where statics says.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from drftjax.effects.base import (
    AbstractZetaFactor,
    EffectInfo,
    Memory,
    MemorylessLoad,
    StepContext,
    along_z,
)
from drftjax.physics.command import Command
from drftjax.physics.rig import AbstractCarriage, DrivenCarriage, FreeCarriage
from drftjax.physics.state import Output, State
from drftjax.simulation.simulator import Simulator
from hils.rig_sim.firmware import MotorDemand

CHANNELS = ("time", "x", "z", "vx", "vz", "omega", "fx", "fz", "zeta")


@dataclass(frozen=True)
class LoweringSettings:
    """Damper that lets the wheel down onto the sand.

    Attributes:
        speed: Of the wheel, until the sand bears it [m/s].
        time: From the release to when the damper lets go, the wheel having stood for a second [s].
    """

    speed: float = 0.06
    time: float = 1.5


DEFAULT_LOWERING = LoweringSettings()


class RigMotion(NamedTuple):
    """Readings of perfect instruments: seconds, metres, radians, newtons."""

    time: float
    x: float
    z: float
    vx: float
    vz: float
    omega: float
    fx: float
    fz: float
    zeta: float


REST = MotorDemand(0.0, 0.0, False)


class SwitchedCarriage(AbstractCarriage):
    """Free, or driven at the commanded vx, as a number says.

    Attributes:
        driven: Above 0 where the carriage is driven.
        drive: The carriage where it is driven.
    """

    driven: Float[Array, ""]
    drive: DrivenCarriage

    def approach(self, velocity: Float[Array, "2"], command: Command) -> Float[Array, "2"]:
        return jnp.where(self.driven > 0, self.drive.approach(velocity, command), velocity)

    def impose(self, velocity: Float[Array, "2"], given: Float[Array, "2"]) -> Float[Array, "2"]:
        return jnp.where(self.driven > 0, self.drive.impose(velocity, given), velocity)

    def advance(
        self,
        velocity: Float[Array, "2"],
        impulse: Float[Array, "2"],
        inertia: Float[Array, "2 2"],
    ) -> Float[Array, "2"]:
        return jnp.where(
            self.driven > 0,
            self.drive.advance(velocity, impulse, inertia),
            FreeCarriage().advance(velocity, impulse, inertia),
        )


class Damper(MemorylessLoad):
    """Lets the wheel down onto the sand.

    Attributes:
        damping: Force per vertical speed [N s/m]; zero once it has let go.
    """

    about: ClassVar = EffectInfo("damper", "rig", "F_z = -damping v_z", "lets the wheel down")
    damping: Float[Array, ""]

    def load(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        moment: StepContext,
        memory: Memory,
    ) -> Float[Array, "2"]:
        return along_z(-self.damping * velocity[1])


class Bed(AbstractZetaFactor):
    """Firmness of the sand, as it was prepared.

    Attributes:
        firmness: Factor on zeta [-].
    """

    about: ClassVar = EffectInfo("bed", "terrain", "ζ = firmness ζ", "how the sand was prepared")
    firmness: Float[Array, ""]

    def begin(self) -> Memory:
        return ()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        return ()

    def factor(self, moment: StepContext, memory: Memory) -> Float[Array, ""]:
        return self.firmness


class RigPhysics:
    """A compiled block of steps; holds no state of a run, so runs may share it.

    Args:
        simulator: Every number of wheel, sand and rig; of its carriage, how it is driven.
        step: Integrator step [s].
        lowering: Damper that lets the wheel down.
    """

    def __init__(
        self, simulator: Simulator, step: float, lowering: LoweringSettings = DEFAULT_LOWERING
    ):
        self.step, self.lowering = step, lowering
        simulator = simulator.prepared()
        self.lowest = -float(simulator.wheel.cut().sinkage_limit)
        self._weight = float(simulator.rig.mass_z * simulator.rig.gravity)
        begun = _equipped(simulator, jnp.zeros(()), jnp.zeros(()), jnp.ones(())).begin(
            State.at_rest(0.0), Command(*jnp.zeros(3))
        )
        flat, unravel = ravel_pytree(begun)
        self._held = jnp.concatenate([jnp.zeros(len(CHANNELS), flat.dtype), flat])

        def block(packed: Float[Array, " packed"], given: Float[Array, "8"]):
            steps, omega, omega_rate, vx, vx_rate, driven, damping, firmness = given
            equipped = _equipped(simulator, driven, damping, firmness)

            def advance(number, carried):
                state, _ = carried
                ahead = number + 1.0
                command = Command(omega + ahead * omega_rate, vx + ahead * vx_rate, jnp.zeros(()))
                state, output = equipped.step(state, command, step)
                return state, _channels(output)

            start = unravel(packed[len(CHANNELS) :]), packed[: len(CHANNELS)]
            state, reading = jax.lax.fori_loop(0, steps.astype(int), advance, start)
            return jnp.concatenate([reading, ravel_pytree(state)[0]])

        self._block = jax.jit(block).lower(self._held, jnp.zeros(8, flat.dtype)).compile()

    def held(self) -> Float[Array, " packed"]:
        """The packed state of a wheel that hangs at touch-down, at x = 0."""
        return self._held

    def motion(self, packed: Float[Array, " packed"]) -> RigMotion:
        """Read a state without noise."""
        return RigMotion(*np.asarray(packed)[: len(CHANNELS)].tolist())

    def advance(
        self,
        packed: Float[Array, " packed"],
        steps: int,
        start: MotorDemand,
        end: MotorDemand,
        lowering: bool = False,
        firmness: float = 1.0,
    ) -> Float[Array, " packed"]:
        """The state after so many steps, omega and vx going evenly from `start` to `end`.

        Args:
            packed: State before.
            steps: Integrator steps to make.
            start, end: Demand at either end of the block; the carriage is as `end` says.
            lowering: True while the damper still lets the wheel down.
            firmness: Factor of the bed on zeta [-].
        """
        if steps < 1:
            return packed
        given = np.asarray(
            [
                steps,
                start.omega,
                (end.omega - start.omega) / steps,
                start.vx,
                (end.vx - start.vx) / steps,
                end.driven,
                lowering * self._weight / self.lowering.speed,
                firmness,
            ],
            self._held.dtype,
        )
        return self._block(packed, given)


def _equipped(
    simulator: Simulator,
    driven: Float[Array, ""],
    damping: Float[Array, ""],
    firmness: Float[Array, ""],
) -> Simulator:
    """The simulator with the rig's own equipment, which a block of steps switches."""
    own = simulator.rig.carriage
    drive = own if isinstance(own, DrivenCarriage) else DrivenCarriage()
    rig = dataclasses.replace(simulator.rig, carriage=SwitchedCarriage(driven, drive))
    effects = (*simulator.effects, Damper(damping), Bed(firmness))
    return dataclasses.replace(simulator, rig=rig, effects=effects)


def _channels(output: Output) -> Float[Array, " channels"]:
    return jnp.stack([getattr(output, each) for each in CHANNELS])
