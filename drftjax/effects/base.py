"""Where an effect plugs into the simulator: one abstract class for each place.

An effect is a small final class with a few numbers. Its *strengths* are zero at the null, where
the step is the reference model's to the bit; its *shapes* (a wavelength, a decay angle) say what
it looks like and matter only beside a strength. An effect that must remember something keeps it
in the state: `begin` makes that memory, and the step hands it back.
"""

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from drftjax.common.arrays import as_real
from drftjax.physics.stress import PlateMotion
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import AbstractWheel, Plates

if TYPE_CHECKING:
    from drftjax.physics.state import Output

Memory = Any


@dataclass(frozen=True)
class EffectInfo:
    """What an effect says of itself.

    Attributes:
        name: Its name in reports and files.
        stage: wheel, terrain, rig, drive or sensor.
        formula: What it changes, in the fields' symbols.
        meaning: The same in words.
        form_of: The effect that this is another form of, and goes by in a diagnosis; empty for
            most.
    """

    name: str
    stage: str
    formula: str
    meaning: str
    form_of: str = ""


def strength(
    unit: str,
    typical: float,
    meaning: str,
    least: float = -math.inf,
    most: float = math.inf,
    far: Sequence[float] = (),
) -> Any:
    """A field that is zero where the effect is absent.

    Args:
        unit: Its SI unit, "-" for none.
        typical: Size that a rig may well show, in that unit: the scale of a fit.
        meaning: What it is.
        least: Smallest value that means something: files may not go below it, fits should not.
        most: Largest such value.
        far: Values that no derivative at zero tells the way to: a search tries them one by one.
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
    """A field that says what an effect looks like, and is free only beside a strength.

    Args:
        unit: Its SI unit.
        default: Its value where nothing is known.
        starts: Values above 0 that together cover what a rig may show: where a fit may start;
            its logarithm is fitted.
        meaning: What it is.
        least: What it must lie above.
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
    """What an effect may know of the step it acts in.

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
        """How fast the rim runs ahead of the ground, r omega - vx [m/s]."""
        return self.radius * self.omega - self.velocity[0]


class AbstractEffect(eqx.Module):
    """A mechanism that the reference model leaves out. `about` says which."""

    about: ClassVar[EffectInfo]


class Memoryless(eqx.Module):
    """Mixin of effects that depend on the present alone; stands before the abstract class."""

    def begin(self, *args: Any, **kwargs: Any) -> Memory:
        """No memory, whatever the run starts from."""
        return ()

    def advance(self, memory: Memory, moment: StepContext) -> Memory:
        """No memory after the step either."""
        return ()


class Adjustable(Protocol):
    """A model by the parts whose numbers an adjustment may change."""

    @property
    def wheel(self) -> AbstractWheel: ...
    @property
    def terrain(self) -> Terrain: ...


Model = TypeVar("Model", bound=Adjustable)


class AbstractAdjustment(AbstractEffect):
    """Changes numbers of the model itself, once, before a run."""

    @abc.abstractmethod
    def adjust(self, model: Model) -> Model:
        """The model with its numbers changed."""


class AbstractDrive(AbstractEffect):
    """Stands between the commanded and the true angular velocity."""

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
        """Angular velocity handed on at the end of the step [rad/s], and the memory after it.

        Args:
            omega: What is asked for, effects before this one included [rad/s].
            angle: Wheel angle at the start of the step [rad].
            dt: Step [s].
            memory: From the step before.
        """


class MemorylessDrive(Memoryless, AbstractDrive):
    """A drive whose speed depends on the present alone."""

    @abc.abstractmethod
    def speed(self, omega: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, ""]:
        """Angular velocity handed on [rad/s].

        Args:
            omega: What is asked for, effects before this one included [rad/s].
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
        """The plates, turned to `angle` [rad], where they really are."""


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
        """Factor on each plate's stress [-], one at the null."""


class MemorylessZetaFactor(Memoryless, AbstractZetaFactor):
    """A factor on zeta that depends on the present alone."""


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
        """Height of the surface over the undisturbed one [m] at the plates.

        Args:
            axle: Place of the axle along x [m].
            ahead: How far ahead of it each plate is [m].
            memory: As `advance` left it.
        """


class MemorylessSurface(Memoryless, AbstractSurface):
    """A surface that no wheel changes."""


class AbstractPlane(AbstractSurface):
    """A surface that is a plane under the whole wheel: all that the theory knows."""

    @abc.abstractmethod
    def plane(
        self, axle: Float[Array, ""], memory: Memory
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Height of the plane under the axle [m], and how much it rises along x [-].

        Args:
            axle: Place of the axle along x [m].
            memory: As `advance` left it.
        """

    def height(
        self, axle: Float[Array, ""], ahead: Float[Array, " plates"], memory: Memory
    ) -> Float[Array, " plates"]:
        under, rise = self.plane(axle, memory)
        return under + rise * ahead


class AbstractLoad(AbstractEffect):
    """A further force on the axle."""

    @abc.abstractmethod
    def begin(self, position: Float[Array, "2"]) -> Memory:
        """Memory at the start of a run, from where the axle is."""

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
        """Force (x, z) on the axle [N]; the step linearises it in `velocity` [m/s]."""


class MemorylessLoad(Memoryless, AbstractLoad):
    """A load that depends on the present alone."""


class AbstractSandLoad(AbstractLoad):
    """A further force of the sand, which a force sensor reads too."""


class AbstractSensor(AbstractEffect):
    """Stands between what is and what is read."""

    def started(self, position: Float[Array, "2"]) -> Float[Array, "2"]:
        """Where the axle (x, z) truly starts [m], from where it reads at rest."""
        return position

    @abc.abstractmethod
    def begin(self, output: "Output") -> Memory:
        """Memory at the start of a run, from the true output there."""

    @abc.abstractmethod
    def read(
        self, output: "Output", dt: Float[Array, ""], memory: Memory
    ) -> tuple["Output", Memory]:
        """The reading, and the memory after the step."""


def along_x(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts forward."""
    return jnp.stack([force, jnp.zeros_like(force)])


def along_z(force: Float[Array, ""]) -> Float[Array, "2"]:
    """A force (x, z) [N] that acts upward."""
    return jnp.stack([jnp.zeros_like(force), force])
