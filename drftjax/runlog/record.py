"""One run as validated arrays: set-up, command, measurements, control loop and events.

Frame: x forward, z up, z = 0 where the rim just touches the undisturbed surface, so the
sinkage is H = -z. omega > 0 drives forward. fx, fz are the sand's force on the wheel. SI units.

Arrays are copied to float64 (or the integer type named), made read-only, and checked when a
record is built, so a record that exists is a valid one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drftjax.common.errors import InputError
from drftjax.runlog import validation as rules
from drftjax.runlog.schema import COLUMNS, ONLINE_NUMBERS, Column

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

Reals = NDArray[np.float64]


SENSORS: Final = tuple(each.name for each in COLUMNS["measured"][1:])
"""Quantities that a rig may measure, in the format's order."""

CHANNELS: Final = tuple(name for name in SENSORS if name != "omega")
"""Those that a simulation is compared with; the wheel's speed is what it is given."""


@dataclass(frozen=True, kw_only=True)
class RecordedSetup:
    """Set-up of the rig as stated by the operator; None where a number is not known.

    Attributes:
        wheel_radius: Rim radius, without grousers [m].
        wheel_width: Width across the track [m].
        grouser_count: Grousers around the rim [-].
        grouser_height: From the rim to the tip [m].
        grouser_thickness: Along the circumference [m].
        mass_x: Mass that moves forward with the wheel [kg].
        mass_z: Mass that rests on the wheel [kg].
        gravity: Free-fall acceleration [m/s^2].
        bulk_density: Bulk density of the sand [kg/m^3].
        sinkage_static: Sinkage H at rest before the run [m].
        scaling_factor_initial: zeta before any tuning [-].

    Raises:
        InputError: a number is not finite or has an impossible sign.
    """

    wheel_radius: float | None = None
    wheel_width: float | None = None
    grouser_count: int | None = None
    grouser_height: float | None = None
    grouser_thickness: float | None = None
    mass_x: float | None = None
    mass_z: float | None = None
    gravity: float | None = None
    bulk_density: float | None = None
    sinkage_static: float | None = None
    scaling_factor_initial: float | None = None

    def __post_init__(self) -> None:
        for name, value in self.known().items():
            _require(rules.setup_problems(name, value))
            plain = int(value) if name == "grouser_count" else float(value)
            object.__setattr__(self, name, plain)

    def known(self) -> dict[str, float | int]:
        """Known numbers by name, in the format's order."""
        pairs = ((each.name, getattr(self, each.name)) for each in fields(self))
        return {name: value for name, value in pairs if value is not None}

    def require(self, *names: str) -> tuple[float, ...]:
        """Return the named numbers.

        Raises:
            InputError: names the first one that is not known.
        """
        for name in names:
            if getattr(self, name) is None:
                raise InputError(f"the set-up does not give {name}, which is needed here")
        return tuple(getattr(self, name) for name in names)


@dataclass(frozen=True, eq=False)
class RecordedCommand:
    """Commands that were sent to the rig; columns of shape (rows,).

    Attributes:
        time: Time from the run's start, increasing [s].
        omega: Wheel speed, positive driving forward [rad/s].
        vx: Speed of a driven carriage [m/s]; None where the carriage ran free.

    Raises:
        InputError: names the column and the rule that it breaks.
    """

    time: Reals
    omega: Reals
    vx: Reals | None = None

    def __post_init__(self) -> None:
        _store_columns(self, "command")


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of the rig, columns of shape (rows,); None for a channel without a sensor.

    Attributes:
        time: Clock of the data logger, from the run's start, increasing [s].
        x: Forward travel [m].
        z: Height of the rim datum, minus the sinkage [m].
        fx: Forward force of the sand on the wheel [N].
        fz: Upward force of the sand on the wheel [N].
        torque: Torque of the drive on the wheel, positive driving forward [N m].
        omega: Wheel speed, positive driving forward [rad/s].

    Raises:
        InputError: names the column and the rule that it breaks, or no channel but omega is given.
    """

    time: Reals
    x: Reals | None = None
    z: Reals | None = None
    fx: Reals | None = None
    fz: Reals | None = None
    torque: Reals | None = None
    omega: Reals | None = None

    def __post_init__(self) -> None:
        _store_columns(self, "measured")
        if not self.channels():
            raise InputError(f"nothing was measured: give at least one of {', '.join(CHANNELS)}")

    def channels(self) -> dict[str, Reals]:
        """Measured channels that a simulation is compared with, by name, in the format's order."""
        pairs = ((name, getattr(self, name)) for name in CHANNELS)
        return {name: values for name, values in pairs if values is not None}

    def select(self, rows: NDArray[np.bool_]) -> "Measured":
        """These rows of every column.

        Args:
            rows: True for each row to keep, shape (rows,).
        """
        pairs = ((name, getattr(self, name)) for name in ("time", *SENSORS))
        return Measured(**{name: each[rows] for name, each in pairs if each is not None})

    @property
    def sinkage(self) -> Reals:
        """Sinkage H = -z, shape (rows,) [m].

        Raises:
            InputError: z was not measured.
        """
        if self.z is None:
            raise InputError("the run has no /measured/z, so its sinkage is not known")
        return -self.z


@dataclass(frozen=True, eq=False)
class Online:
    """Record of the control loop of a hardware-in-the-loop run, one row for each tick.

    Its columns are those of `drftjax.runlog.schema.COLUMNS["online"]`, of shape (rows,).

    Attributes:
        time: Clock of the controller, from the run's start, increasing [s].
        zeta: Scaling factor in use [-].
        x_sim, z_sim: Simulated position [m].
        vx_sim: Simulated speed, which drives the carriage [m/s].
        fx_sim: Simulated forward force [N].
        fz_sim: Simulated upward force [N]; None in a log of a program that did not record it.
        tuned: 1 where zeta was changed on this tick.
        late: Delay beyond the deadline of the tick, or of the first one skipped before it; 0 in
            time [s].
        age: Age of the measurement that was used [s].
        flags: Bits of the events of this tick.
        seq_sent, seq_received: Sequence numbers on the wire.
        rig_time: Clock of the rig [s].
        ack_seq: Sequence number of the command that the newest measurement answers. This and those
            below are None in a log of a program that did not record them.
        rig_state, rig_fault: As the rig said with it; docs/reference/wire.md has the states.
        work_time: From waking to the command being away [s].
        wake_delay: From the due time of the tick, or of the first one skipped before it, to
            waking [s].
        tick: Control period [s].
        zeta_step: Change of zeta in one tuning step [-].
        tolerance: Largest sinkage error at which zeta is not changed [m].
        loop: Inputs and settings of the loop as JSON, from which the run can be replayed.
        meanings: Word for each bit of the flags.

    Raises:
        InputError: names the column or the number, and the rule that it breaks.
    """

    time: Reals
    zeta: Reals
    x_sim: Reals
    z_sim: Reals
    vx_sim: Reals
    fx_sim: Reals
    fz_sim: Reals | None = field(default=None, kw_only=True)
    tuned: NDArray[np.uint8]
    late: Reals
    age: Reals
    flags: NDArray[np.uint32]
    seq_sent: NDArray[np.uint32]
    seq_received: NDArray[np.uint32]
    rig_time: Reals
    ack_seq: NDArray[np.uint32] | None = field(default=None, kw_only=True)
    rig_state: NDArray[np.uint16] | None = field(default=None, kw_only=True)
    rig_fault: NDArray[np.uint16] | None = field(default=None, kw_only=True)
    work_time: Reals | None = field(default=None, kw_only=True)
    wake_delay: Reals | None = field(default=None, kw_only=True)
    tick: float
    zeta_step: float
    tolerance: float
    loop: str | None = None
    meanings: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _store_columns(self, "online")
        for name in ONLINE_NUMBERS:
            value = float(getattr(self, name))
            if not np.isfinite(value) or value < 0 or (name == "tick" and value == 0):
                raise InputError(f"{name} is {value}, it must be finite and not negative")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class Events:
    """Events of a run in their order, columns of shape (rows,).

    Attributes:
        event_time: Time from the run's start, never decreasing; several events may share it [s].
        code: Code of the event, a key of `meanings`.
        arg: Number that belongs to the event.
        meanings: Words for each code.

    Raises:
        InputError: names the column and the rule that it breaks.
    """

    event_time: Reals
    code: NDArray[np.int32]
    arg: Reals
    meanings: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _store_columns(self, "events")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RunLog:
    """One run.

    Attributes:
        setup: Set-up of the rig as stated by the operator.
        command: Commands.
        measured: Measurements.
        source: Origin: "measured", "virtual rig", "simulated" or "imported".
        title: Title for people.
        online: Record of the control loop; None where there was none.
        events: Events; None where none were recorded.
        created: Date and time at which the run began, as text.
        run_id: Identifier that no other run has.
        notes: Free text.
        software: Name of the program that wrote the run.
        software_version: Its version.
        end_reason: Reason why a recorded run ended; None where it was not recorded online.

    Raises:
        InputError: the source is unknown, or a text cannot be written to a file.
    """

    setup: RecordedSetup
    command: RecordedCommand
    measured: Measured
    source: str
    title: str
    online: Online | None = None
    events: Events | None = None
    created: str | None = None
    run_id: str | None = None
    notes: str | None = None
    software: str | None = None
    software_version: str | None = None
    end_reason: str | None = None

    def __post_init__(self) -> None:
        _require(rules.source_problems(self.source))
        for each in fields(self):
            text = getattr(self, each.name)
            if isinstance(text, str):
                _require(rules.text_problems(each.name, text))

    def plot(self) -> "Figure":
        """Every channel over time, in a figure without a window.

        Raises:
            InputError: names a channel whose numbers are too large for an axis.
        """
        from drftjax.runlog.figure import plot_run

        return plot_run(self)

    def to_xarray(self, derived: bool = False) -> "xarray.Dataset":
        """Measurements, and the commands at their times, each with its unit.

        Args:
            derived: True to add slip, speed and the other derived channels.

        Raises:
            InputError: xarray is not installed, or no channel can be derived.
        """
        from drftjax.runlog.export.frames import as_dataset

        return as_dataset(self, derived)

    def to_dataframe(self, derived: bool = False) -> "pandas.DataFrame":
        """Measurements, and the commands at their times, with the time as index.

        Args:
            derived: True to add slip, speed and the other derived channels.

        Raises:
            InputError: pandas is not installed, or no channel can be derived.
        """
        from drftjax.runlog.export.frames import as_data_frame

        return as_data_frame(self, derived)

    def __repr__(self) -> str:
        from drftjax.runlog.summary import one_line

        return f"<RunLog {one_line(self)}>"

    def _repr_html_(self) -> str:
        from drftjax.runlog.summary import as_html

        return as_html(self)


def _store_columns(record: object, title: str) -> None:
    """Replace a record's columns by read-only arrays of the format's types, and check them.

    Args:
        record: A frozen dataclass with a field for each column.
        title: Name of its group.
    """
    axis, *channels = COLUMNS[title]
    repeats = title == "events"
    time = _column(axis, getattr(record, axis.name))
    object.__setattr__(record, axis.name, time)
    if time.size == 0 and not repeats:
        raise InputError(f"{axis.name} has no rows; a run has at least one")
    problems = [rules.axis_problems(axis.name, time, repeats)]
    for column in channels:
        given = getattr(record, column.name)
        if given is None:
            continue
        values = _column(column, given)
        object.__setattr__(record, column.name, values)
        problems.append(rules.channel_problems(column.name, values, time.size, axis.name))
    _require(chain(*problems))


def _column(column: Column, given: ArrayLike) -> NDArray[Any]:
    """Read-only copy of a column in the format's type, shape (rows,)."""
    name, dtype = column.name, np.dtype(column.dtype)
    if given is None:
        raise InputError(f"{name} is missing; it must be given")
    raw = np.asarray(given)
    if raw.dtype.kind not in "biuf":
        raise InputError(f"{name} holds {raw.dtype}, it must hold real numbers")
    if raw.ndim != 1:
        raise InputError(f"{name} has shape {raw.shape}, it must be one column of numbers")
    values = np.array(raw, dtype=dtype)
    if column.integer is not None and not np.array_equal(values, raw):
        raise InputError(f"{name} holds numbers that {dtype.name} cannot hold")
    values.setflags(write=False)
    return values


def _require(problems: Iterable[str]) -> None:
    """Raise an InputError with the first problem."""
    for sentence in problems:
        raise InputError(sentence)
