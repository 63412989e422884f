"""Set-up of a trial as a file, and the trial built from it.

Each table of the file is a structure that reads it, checks its types and builds a part of the
simulator. A `SetUp` is complete; a run log's `RecordedSetup` (`drftjax.runlog.record`) holds the
few numbers that its operator knew, and `drftjax.setups.from_run` completes them.
"""

import copy
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.common.packages import require_known
from drftjax.common.structured_files import read_document, to_structure
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import catalogue, effect_class, field_metadata
from drftjax.effects.serialization import Entry, build_effects, entry_of, name_of
from drftjax.physics.integrator import DEFAULT_STEP, ImplicitEuler
from drftjax.physics.outline_wheel import OutlineWheel, read_outline
from drftjax.physics.rig import DrivenCarriage, FreeCarriage, Rig
from drftjax.physics.state import State
from drftjax.physics.wheel import (
    DEFAULT_PLATE_SIZE,
    DEFAULT_REACH,
    LARGEST_RADIUS,
    PLAIN_PLATE_SIZE,
    AbstractWheel,
    GrouserWheel,
    PlainWheel,
)
from drftjax.runlog.record import RecordedCommand
from drftjax.runlog.validation import text_problems
from drftjax.setups.checked_table import CheckedTable
from drftjax.setups.terrain_setup import DynamicTerrain, TerrainSetUp, with_law
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.trial import ROW_INTERVAL, Trial

# Steps of a trial: hours at the default step; more is a slip of units, and would fill the memory.
MAX_STEPS = 2e7


MAX_OMEGA = 100.0  # commanded angular velocity [rad/s]


METHOD = "implicit"


# Methods that set-up files of before version 0.1 name.
REMOVED_METHODS = ("rosenbrock", "held pace", "explicit")


if TYPE_CHECKING:
    EffectEntry = Entry | AbstractEffect
else:
    EffectEntry = Entry  # what msgspec reads from a file


PAPER_RADIUS = 0.150  # rim of the wheel of Fuke, Ishikawa & Ishigami 2024 [m]


class WheelSetUp(CheckedTable):
    """[wheel]: lengths in metres. `outline` names a CSV file, or `points` lists its corners.

    Where `plate_size` is not given, it is 4 mm, of a bare rim 1 mm, and less in proportion on
    wheels smaller than the paper's: with plates of 4 mm a healthy wheel of 50 mm seems to have
    another radius than it has.
    """

    place: ClassVar[str] = "wheel"

    shape: Literal["grouser", "plain", "outline"] = "grouser"
    radius: float = PAPER_RADIUS
    width: float = 0.120
    grouser_count: int = 12
    grouser_height: float = 0.018
    grouser_thickness: float = 0.009
    grouser_fraction: float = 1.0
    outline: str | None = None
    points: list[tuple[float, float]] | None = None
    plate_size: float | None = None

    @property
    def plate_length(self) -> float:
        """Length that no plate exceeds [m]."""
        if self.plate_size is not None:
            return self.plate_size
        size = PLAIN_PLATE_SIZE if self.shape == "plain" else DEFAULT_PLATE_SIZE
        return size * min(1.0, self.radius / PAPER_RADIUS)

    def check(self) -> None:
        self.plate_size = self.plate_length  # so that files say it
        # The corners of an outline in a file are read by `find_outline`.
        if self.shape != "outline" or self.outline is None:
            self.build()

    def build(self, reach: float = DEFAULT_REACH) -> AbstractWheel:
        """The wheel as far as it comes within `reach` [rad] of straight down; an outline whole."""
        if self.shape != "outline" and (self.outline is not None or self.points is not None):
            raise InputError(
                f"[wheel] gives an outline, but its shape is {self.shape!r}; say shape = 'outline'"
            )
        if self.shape == "plain":
            return PlainWheel(self.radius, self.width, plate_size=self.plate_length, reach=reach)
        if self.shape == "outline":
            if self.points is None:
                raise InputError("[wheel] of shape 'outline' needs points, or outline = a CSV file")
            return OutlineWheel(self.points, self.radius, self.width, plate_size=self.plate_length)
        return GrouserWheel(
            self.radius,
            self.width,
            self.grouser_count,
            self.grouser_height,
            self.grouser_thickness,
            self.grouser_fraction,
            plate_size=self.plate_length,
            reach=reach,
        )


class RigSetUp(CheckedTable):
    """[rig]: masses in kg, damping in N s/m, drawbar_load in N, gravity in m/s2."""

    place: ClassVar[str] = "rig"

    mass_x: float = 13.902
    mass_z: float = 18.837
    damping_x: float = 0.0
    damping_z: float = 0.0
    drawbar_load: float = 0.0
    gravity: float = 9.81
    carriage: Literal["free", "driven"] = "free"

    def check(self) -> None:
        self.build()

    def build(self) -> Rig:
        return Rig(
            self.mass_x,
            self.mass_z,
            self.damping_x,
            self.damping_z,
            self.drawbar_load,
            self.gravity,
            DrivenCarriage() if self.carriage == "driven" else FreeCarriage(),
        )


class StartSetUp(CheckedTable):
    """[start]: sinkage and x in metres, wheel angle in radians, forward speed in m/s.

    `origin` is the place on the rig's own scale [m] from which the x of this set-up counts: a
    diagnosis writes it, so that its effects keep their places on the bed.
    """

    place: ClassVar[str] = "start"

    sinkage: float = 0.0176
    x: float = 0.0
    angle: float = 0.0
    speed: float = 0.0
    origin: float | None = None

    def check(self) -> None:
        hint = " m; are these mm?"
        require_between("start sinkage", self.sinkage, -LARGEST_RADIUS, LARGEST_RADIUS, hint)
        require_between("start x", self.x, -1e3, 1e3, " m")
        require_between("start origin", self.origin or 0.0, -1e3, 1e3, " m")
        require_between("start angle", self.angle, -1e3, 1e3, " rad")
        require_between("start speed", self.speed, -10.0, 10.0, " m/s")


class CommandSetUp(CheckedTable):
    """[command]: knots of a profile, linear in between: time in s, omega, and vx in m/s."""

    place: ClassVar[str] = "command"

    time: list[float]
    omega: list[float]
    vx: list[float] | None = None
    omega_unit: Literal["rad/s", "deg/s"] = "rad/s"

    def check(self) -> None:
        self.build()

    def build(self) -> RecordedCommand:
        omega = np.asarray(self.omega, dtype=float)
        fastest = _farthest(omega)
        if self.omega_unit == "deg/s":
            most = np.degrees(MAX_OMEGA)
            require_between("command omega", fastest, -most, most, " deg/s")
            omega = np.radians(omega)
        hint = " rad/s; are these deg/s?" if np.isfinite(fastest) else " rad/s"
        require_between("command omega", _farthest(omega), -MAX_OMEGA, MAX_OMEGA, hint)
        if self.vx is not None:
            require_between("command vx", _farthest(self.vx), -10.0, 10.0, " m/s")
        vx = None if self.vx is None else np.asarray(self.vx, dtype=float)
        try:
            command = RecordedCommand(time=np.asarray(self.time, dtype=float), omega=omega, vx=vx)
        except InputError as problem:
            raise InputError(f"command.{problem}") from None
        if len(command.time) < 2:
            raise InputError("the command has one knot in time, needs two or more")
        return command


def _farthest(values: ArrayLike) -> float:
    """The value farthest from zero, or one that is not finite, for an error message."""
    given = np.asarray(values, dtype=float)
    return float(given[np.argmax(np.abs(given))]) if given.size else 0.0


class IntegratorSetUp(CheckedTable):
    """[integrator]: the step in seconds; where none is given, programs choose one for the run.

    There is one method, implicit Euler; `method` may name it.
    """

    place: ClassVar[str] = "integrator"

    method: str = METHOD
    step: float | None = None

    def check(self) -> None:
        self.build()

    def build(self) -> tuple[ImplicitEuler, float]:
        """The integrator, and its step [s].

        Raises:
            InputError: for a method that is not there, or was removed, and a step out of bounds.
        """
        if self.method in REMOVED_METHODS:
            raise InputError(
                f"integrator.method {self.method!r} was removed, and its step does not hold for "
                f"{METHOD!r}: leave [integrator] out, or say method = {METHOD!r} with a step"
            )
        require_known("integrator.method", self.method, (METHOD,))
        step = DEFAULT_STEP if self.step is None else self.step
        require_between("integrator step", step, 1e-6, 0.1, " s")
        return ImplicitEuler(), step


class SetUp(CheckedTable):
    """Complete set-up of a trial, as a file holds it: the operator's model of wheel, sand and rig.

    The defaults are Tables 1 to 3 of Fuke, Ishikawa & Ishigami 2024. It is the model of a
    simulation or a fit, not the record of a run: that is `drftjax.runlog.record.RecordedSetup`.
    """

    command: CommandSetUp
    title: str = "simulated run"
    wheel: WheelSetUp = msgspec.field(default_factory=WheelSetUp)
    terrain: TerrainSetUp = msgspec.field(default_factory=DynamicTerrain)
    rig: RigSetUp = msgspec.field(default_factory=RigSetUp)
    start: StartSetUp = msgspec.field(default_factory=StartSetUp)
    integrator: IntegratorSetUp = msgspec.field(default_factory=IntegratorSetUp)
    # [[effect]] each: a name and numbers; `drft effects` lists them. In Python, also an effect.
    effects: list[EffectEntry] = msgspec.field(default_factory=list, name="effect")

    def __post_init__(self) -> None:
        if isinstance(self.terrain, dict):
            self.terrain = with_law({"terrain": self.terrain})["terrain"]
        effects = self.effects
        if isinstance(effects, list) and any(isinstance(e, AbstractEffect) for e in effects):
            self.effects = []  # no type that a file may hold
        super().__post_init__()
        self.effects = effects

    def check(self) -> None:
        """Refuse tables that contradict each other; each has checked itself."""
        for reason in text_problems("title", self.title):
            raise InputError(reason)
        if self.rig.carriage == "driven" and self.command.vx is None:
            raise InputError("the carriage is driven, so [command] needs vx in m/s")
        if self.rig.carriage == "free" and self.command.vx is not None:
            raise InputError("[command] gives vx, but the carriage of [rig] is free, not 'driven'")
        radius = self.wheel.radius
        require_between("start sinkage", self.start.sinkage, -radius, radius, " m; are these mm?")

    def trial(self, interval: float = ROW_INTERVAL) -> Trial:
        """The trial that this set-up describes, ready to run.

        Args:
            interval: Time between rows of its output [s].

        Raises:
            InputError: names a number out of bounds, or tables that contradict each other.
        """
        self.check()
        integrator, step = self.integrator.build()
        simulator = Simulator(
            self.wheel.build(),
            self.terrain.build(),
            self.rig.build(),
            integrator,
            tuple(build_effects(entry, place) for place, entry in enumerate(self.effects, start=1)),
        )
        simulator.check()
        command = self.command.build()
        self.start.check()
        require_between(
            "the number of steps",
            float(command.time[-1] - command.time[0]) / float(step),
            0,
            MAX_STEPS,
            " (times are in seconds)",
        )
        start = State.at_rest(self.start.sinkage, self.start.x, self.start.angle, self.start.speed)
        return Trial.of(simulator, start, command, step, interval)


def as_in_file(setup: SetUp) -> SetUp:
    """A copy of a set-up whose effects are all entries, as a file holds them."""
    written = copy.copy(setup)
    written.effects = [
        entry_of(each) if isinstance(each, AbstractEffect) else each for each in setup.effects
    ]
    return written


def read_setup(path: str | Path) -> SetUp:
    """Read a set-up file (TOML or JSON); the file of a wheel's outline lies in the same folder.

    Args:
        path: Set-up file.

    Raises:
        InputError: names the file, the entry and its bounds.
    """
    path = Path(path)
    setup = to_structure(read_tables(path), SetUp, path)
    find_outline(setup.wheel, path)
    try:
        setup.trial()
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    return setup


def read_tables(path: Path) -> dict[str, Any]:
    """Tables of a set-up file (TOML or JSON), its [terrain] with the name of a stress law.

    Raises:
        InputError: names the file, and an unknown law or numbers that its law has not.
    """
    document = read_document(path)
    try:
        return with_law(document)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def find_outline(wheel: WheelSetUp, path: Path) -> None:
    """Read the corners of a wheel whose outline lies in the folder of its set-up file.

    Raises:
        InputError: names the set-up file, and that of the outline.
    """
    if wheel.outline is None:
        return
    if wheel.points is not None:
        raise InputError(f"{path}: [wheel] has both points and an outline; give one of them")
    try:
        wheel.points = [(x, z) for x, z in read_outline(path.parent / wheel.outline).tolist()]
    except InputError as problem:
        raise InputError(f"{path}: outline of [wheel]: {problem}") from None


def add_fitted_effects(setup: SetUp, names: Iterable[str]) -> None:
    """Add to a set-up the effects whose numbers are to be fitted, where it has none of them.

    A number that may not be negative starts from its typical size where it is zero: its logarithm
    is fitted, or its place within its bounds.

    Args:
        setup: Changed in place.
        names: Parameters' names, those of other numbers among them.
    """
    for name in names:
        if name.partition(".")[0] not in catalogue():
            continue
        title, field = name.split(".")
        entry = next((each for each in setup.effects if name_of(each) == title), None)
        if entry is None:
            entry = Entry(name=title)
            setup.effects.append(entry)
        about = field_metadata(effect_class(title))[field]
        if isinstance(entry, AbstractEffect):
            continue  # its numbers are the user's
        if "typical" in about and about["least"] == 0 and not entry.get(field):
            entry[field] = about["typical"]
