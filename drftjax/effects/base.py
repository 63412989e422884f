"""Abstract classes of effects: one for each place of the step that an effect acts in.

An effect is a small final class with a few numbers. Its *strengths* are zero at the null, where
the step is the reference model's to the bit; its *shapes* (a wavelength, a decay angle) give its
form and matter only where a strength is not zero. An effect with a memory keeps it in the state:
`begin` makes the memory, and the step hands it back.
"""

import abc
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.physics.rig import Rig
from drftjax.physics.stress import PlateMotion
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import AbstractWheel, Plates

if TYPE_CHECKING:
    from drftjax.physics.state import Output

Memory = Any


@dataclass(frozen=True)
class EffectInfo:
    """Name, stage and meaning of an effect.

    Attributes:
        name: Its name in reports and files.
        stage: wheel, terrain, rig, drive or sensor.
        formula: The change that it makes, in the fields' symbols.
        meaning: The same in words.
        form_of: Name of the effect that this is another form of, under which a diagnosis reports
            it; empty for most.
        hypothesis: False for an effect that set-ups and fits may have, and that a diagnosis looks
            for only where it is named: it moves most runs as another zeta does, no blind test has
            measured yet how well it is told from the others, or it takes longer than another form.
        channels: Channels among x, z, fx, fz, torque that it shows in, of which a diagnosis must
            compare one; empty where it moves the wheel, and so shows in any.
        sum_of: Name of the effect, of one shape or more, that this is a sum of several of, with
            their strengths one after the other, and then their shapes; a diagnosis tries it in the
            place of another form.
    """

    name: str
    stage: str
    formula: str
    meaning: str
    form_of: str = ""
    hypothesis: bool = True
    channels: tuple[str, ...] = ()
    sum_of: str = ""

    def require_shown(self, compared: Collection[str]) -> None:
        """Refuse an effect that none of the compared channels shows.

        Args:
            compared: Names among x, z, fx, fz, torque.

        Raises:
            InputError: names the channels that do.
        """
        if self.channels and not set(self.channels) & set(compared):
            shown, given = " or ".join(self.channels), ", ".join(compared)
            raise InputError(f"{self.name} shows in {shown}, and only {given} are compared")


def strength(
    unit: str,
    typical: float,
    meaning: str,
    least: float = -math.inf,
    most: float = math.inf,
    far: Sequence[float] = (),
) -> Any:
    """Field of an effect that is zero where the effect is absent.

    Args:
        unit: Its SI unit, "-" for none.
        typical: Size that a rig may well show, in that unit: the scale of a fit.
        meaning: Its meaning in words.
        least: Smallest value with a meaning: files may not go below it, fits should not.
        most: Largest such value.
        far: Values that no derivative at zero leads to: a search tries them one by one.
    """
    return eqx.field(
        converter=as_real,
        default=0.0,
        metadata={
            "unit": unit,
            "typical": typical,
            "meaning": meaning,
            "least": least,
            "most": most,
            "far": tuple(far),
        },
    )


def shape(
    unit: str, default: float, starts: Sequence[float], meaning: str, least: float = 0.0
) -> Any:
    """Field of an effect's form, which matters only where a strength is not zero.

    Args:
        unit: Its SI unit.
        default: Its value where none is given.
        starts: Values above 0 that together cover what a rig may show: a fit of its logarithm may
            start from each.
        meaning: Its meaning in words.
        least: Value that it must exceed.
    """
    return eqx.field(
        converter=as_real,
        default=default,
        metadata={
            "unit": unit,
            "starts": tuple(starts),
            "meaning": meaning,
            "least": least,
            "most": math.inf,
        },
    )


class StepContext(eqx.Module):
    """Quantities of a step that its effects may depend on.

    Attributes:
        time: End of the step [s].
        dt: Step [s].
        position, velocity: Of the axle (x, z) at its start [m], [m/s].
        angle, omega: Of the wheel at its end [rad], [rad/s].
        commanded: Commanded angular velocity at its end [rad/s].
        radius: Rim radius [m].
    """

    time: Float[Array, ""]
    dt: Float[Array, ""]
    position: Float[Array, "2"]
    velocity: Float[Array, "2"]
    angle: Float[Array, ""]
    omega: Float[Array, ""]
    commanded: Float[Array, ""]
    radius: Float[Array, ""]

    def rim_slip(self) -> Float[Array, ""]:
        """Slip speed of the rim over the ground, r omega - vx [m/s]."""
        return self.radius * self.omega - self.velocity[0]


class AbstractEffect(eqx.Module):
    """A mechanism beyond the reference model, described by `about`."""

    about: ClassVar[EffectInfo]


class Memoryless(eqx.Module):
    """Mixin of effects without a memory; to be named before the abstract class."""

    def begin(self, *args: Any, **kwargs: Any) -> Memory:
        """No memory, whatever the run starts from."""
        return ()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        """No memory after the step either."""
        return ()


class Adjustable(Protocol):
    """A model with the parts whose numbers an adjustment may change."""

    @property
    def wheel(self) -> AbstractWheel: ...
    @property
    def terrain(self) -> Terrain: ...
    @property
    def rig(self) -> Rig: ...


Model = TypeVar("Model", bound=Adjustable)


class AbstractAdjustment(AbstractEffect):
    """Changes numbers of the model itself, once, before a run."""

    @abc.abstractmethod
    def adjust(self, model: Model) -> Model:
        """The model with changed numbers."""


class AbstractDrive(AbstractEffect):
    """Turns the commanded angular velocity into the true one."""

    @abc.abstractmethod
    def begin(self, omega: Float[Array, ""], angle: Float[Array, ""]) -> Memory:
        """Memory at the start of a run, from the wheel's motion there."""

    @abc.abstractmethod
    def turn(
        self,
        omega: Float[Array, ""],
        angle: Float[Array, ""],
        dt: Float[Array, ""],
        memory: Memory,
    ) -> tuple[Float[Array, ""], Memory]:
        """Angular velocity at the end of the step.

        Args:
            omega: Commanded, as the effects before this one hand it on [rad/s].
            angle: Wheel angle at the start of the step [rad].
            dt: Step [s].
            memory: From the step before.

        Returns:
            Angular velocity handed on [rad/s], and the memory after the step.
        """


class MemorylessDrive(Memoryless, AbstractDrive):
    """A drive without a memory."""

    @abc.abstractmethod
    def speed(self, omega: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, ""]:
        """Angular velocity handed on [rad/s].

        Args:
            omega: Commanded, as the effects before this one hand it on [rad/s].
            angle: Wheel angle that this leads to at the end of the step [rad].
        """

    def turn(
        self,
        omega: Float[Array, ""],
        angle: Float[Array, ""],
        dt: Float[Array, ""],
        memory: Memory,
    ) -> tuple[Float[Array, ""], Memory]:
        return self.speed(omega, angle + dt * omega), ()


class AbstractPlacement(AbstractEffect):
    """Moves the wheel's plates about the axle."""

    @abc.abstractmethod
    def place(self, plates: Plates, angle: Float[Array, ""]) -> Plates:
        """The plates about the axle, moved to their true places.

        Args:
            plates: Turned to the wheel angle.
            angle: Wheel angle [rad].
        """


class AbstractZetaFactor(AbstractEffect):
    """Scales zeta under the whole wheel."""

    @abc.abstractmethod
    def begin(self) -> Memory:
        """Memory at the start of a run."""

    @abc.abstractmethod
    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        """The memory after the step."""

    @abc.abstractmethod
    def factor(self, moment: StepContext, memory: Memory) -> Float[Array, ""]:
        """Factor on zeta [-], one at the null."""


class AbstractStressFactor(AbstractEffect):
    """Scales the stress of each plate."""

    @abc.abstractmethod
    def factor(self, motion: PlateMotion) -> Float[Array, " plates"]:
        """Factor on each plate's stress [-], shape (plates,), one at the null."""


class MemorylessZetaFactor(Memoryless, AbstractZetaFactor):
    """A factor on zeta without a memory."""


class AbstractSurface(AbstractEffect):
    """Raises or lowers the sand's surface."""

    @abc.abstractmethod
    def begin(self) -> Memory:
        """Memory at the start of a run."""

    @abc.abstractmethod
    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        """The memory after the step."""

    @abc.abstractmethod
    def height(
        self, axle: Float[Array, ""], ahead: Float[Array, " plates"], memory: Memory
    ) -> Float[Array, " plates"]:
        """Height of the surface over the undisturbed one at the plates [m], shape (plates,).

        Args:
            axle: Place of the axle along x [m].
            ahead: Distance of each plate ahead of the axle [m], shape (plates,).
            memory: After the last `advance`.
        """


class MemorylessSurface(Memoryless, AbstractSurface):
    """A surface without a memory: no wheel changes it."""


class AbstractPlane(AbstractSurface):
    """A surface that is a plane under the whole wheel, as resistive force theory assumes."""

    @abc.abstractmethod
    def plane(
        self, axle: Float[Array, ""], memory: Memory
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Height of the plane under the axle [m], and its slope along x [-].

        Args:
            axle: Place of the axle along x [m].
            memory: After the last `advance`.
        """

    def height(
        self, axle: Float[Array, ""], ahead: Float[Array, " plates"], memory: Memory
    ) -> Float[Array, " plates"]:
        under, rise = self.plane(axle, memory)
        return under + rise * ahead


class AbstractIncline(AbstractEffect):
    """A plane under the whole wheel, in whose frame the sand's stress is worked out.

    Depths are distances from the plane, normals and directions are turned into its frame, and the
    force is turned back; see `drftjax.physics.surface_frame`. `AbstractPlane` changes depths alone.
    """

    @abc.abstractmethod
    def plane(self, axle: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Height of the plane under the axle [m], and its slope along x [-].

        Args:
            axle: Place of the axle along x [m].
        """


class AbstractLoad(AbstractEffect):
    """A further force on the axle."""

    @abc.abstractmethod
    def begin(self, position: Float[Array, "2"]) -> Memory:
        """Memory at the start of a run, from the place (x, z) of the axle [m]."""

    @abc.abstractmethod
    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        """The memory after the step."""

    @abc.abstractmethod
    def load(
        self,
        position: Float[Array, "2"],
        velocity: Float[Array, "2"],
        moment: StepContext,
        memory: Memory,
    ) -> Float[Array, "2"]:
        """Force (x, z) on the axle [N]; the step linearises it in the velocity.

        Args:
            position: Axle position (x, z) [m].
            velocity: Axle velocity (x, z) [m/s].
            moment: The step.
            memory: After the last `advance`.
        """


class MemorylessLoad(Memoryless, AbstractLoad):
    """A load without a memory."""


class AbstractSandLoad(AbstractLoad):
    """A further force of the sand, which a force sensor reads too."""


class AbstractSensor(AbstractEffect):
    """Turns the true output into the reading of the instruments."""

    def started(self, position: Float[Array, "2"], weight: Float[Array, ""]) -> Float[Array, "2"]:
        """True start (x, z) of the axle [m], from its reading at rest.

        Args:
            position: Reading at rest (x, z) [m].
            weight: Vertical load that the sand carries there [N].
        """
        return position

    @abc.abstractmethod
    def begin(self, output: "Output") -> Memory:
        """Memory at the start of a run, from the true output there."""

    @abc.abstractmethod
    def read(
        self, output: "Output", dt: Float[Array, ""], memory: Memory
    ) -> tuple["Output", Memory]:
        """The reading, and the memory after the step.

        Args:
            output: True output, or the reading of the sensor before this one.
            dt: Step [s].
            memory: From the step before.
        """


class MemorylessSensor(AbstractSensor):
    """A sensor whose reading depends on the present alone."""

    @abc.abstractmethod
    def reading(self, output: "Output") -> "Output":
        """The reading, of the true output or of the reading of the sensor before this one."""

    def begin(self, output: "Output") -> Memory:
        return ()

    def read(
        self, output: "Output", dt: Float[Array, ""], memory: Memory
    ) -> tuple["Output", Memory]:
        return self.reading(output), ()


def along_x(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts forward."""
    return jnp.stack([force, jnp.zeros_like(force)])


def along_z(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts upward."""
    return jnp.stack([jnp.zeros_like(force), force])
