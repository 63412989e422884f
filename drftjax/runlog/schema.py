"""Run-log format, version 1: groups, columns, units and names.

The one table of the columns. The checks of a record and of a file, the integer types of a file,
the row of the control loop and the bytes that bring it to the recorder all derive from `COLUMNS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

SCHEMA: Final = "drft-run"

SCHEMA_VERSION: Final = 1


@dataclass(frozen=True)
class Column:
    """One column of a group: a dataset with a row for each time of its axis.

    Attributes:
        name: Name of the dataset, and of the field of the record that holds it.
        unit: SI unit, as the attribute `units` spells it; "1" is dimensionless.
        dtype: Type in a record and in a file: float64, or an integer type.
        since_version: Version of the format that brought the column; an older file lacks it, and
            its field of the record is then None.
        optional: True where a file of any version may lack it.
    """

    name: str
    unit: str
    dtype: type[np.number[Any]] = np.float64
    since_version: int = 1
    optional: bool = False

    @property
    def integer(self) -> "np.iinfo[Any] | None":
        """Limits of the integer type; None for a column of real numbers."""
        return np.iinfo(self.dtype) if issubclass(self.dtype, np.integer) else None

    def is_required(self, version: int) -> bool:
        """True where a file of this version of the format must have the column."""
        return not self.optional and self.since_version <= version


COLUMNS: Final[Mapping[str, tuple[Column, ...]]] = {
    "command": (
        Column("time", "s"),
        Column("omega", "rad/s"),
        Column("vx", "m/s", optional=True),
    ),
    "measured": (
        Column("time", "s"),
        Column("x", "m", optional=True),
        Column("z", "m", optional=True),
        Column("fx", "N", optional=True),
        Column("fz", "N", optional=True),
        Column("torque", "N m", optional=True),
        Column("omega", "rad/s", optional=True),
    ),
    "online": (
        Column("time", "s"),
        Column("zeta", "1"),
        Column("x_sim", "m"),
        Column("z_sim", "m"),
        Column("vx_sim", "m/s"),
        Column("fx_sim", "N"),
        Column("fz_sim", "N", optional=True),  # came without a new version
        Column("tuned", "1", np.uint8),
        Column("late", "s"),
        Column("age", "s"),
        Column("flags", "1", np.uint32),
        Column("seq_sent", "1", np.uint32),
        Column("seq_received", "1", np.uint32),
        Column("rig_time", "s"),
        Column("ack_seq", "1", np.uint32, optional=True),  # this and the rest likewise
        Column("rig_state", "1", np.uint16, optional=True),
        Column("rig_fault", "1", np.uint16, optional=True),
        Column("work_time", "s", optional=True),
        Column("wake_delay", "s", optional=True),
    ),
    "events": (
        Column("event_time", "s"),
        Column("code", "1", np.int32),
        Column("arg", "1"),
    ),
}
"""Columns by group, in the order of a row; the first is the group's time axis."""

UNITS: Final[Mapping[str, Mapping[str, str]]] = {
    title: {each.name: each.unit for each in columns} for title, columns in COLUMNS.items()
}

AXES: Final[Mapping[str, str]] = {title: columns[0].name for title, columns in COLUMNS.items()}

MANDATORY_GROUPS: Final = ("command", "measured")

SETUP_UNITS: Final[Mapping[str, str]] = {
    "wheel_radius": "m",
    "wheel_width": "m",
    "grouser_count": "1",
    "grouser_height": "m",
    "grouser_thickness": "m",
    "mass_x": "kg",
    "mass_z": "kg",
    "gravity": "m/s^2",
    "bulk_density": "kg/m^3",
    "sinkage_static": "m",
    "scaling_factor_initial": "1",
}
"""Units of the numbers of /setup, in the order of `RecordedSetup`."""

ONLINE_NUMBERS: Final = ("tick", "zeta_step", "tolerance")
"""Numeric attributes of /online."""

TEXTS: Final = ("created", "run_id", "notes", "software", "software_version", "end_reason")
"""Optional text attributes of a run log."""

BOOKKEEPING: Final = frozenset({"n_committed"})
"""Datasets that a recorder writes beside those of the format."""

SPELLINGS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("", "-", "dimensionless", "none"), "1"),
    **dict.fromkeys(("N*m", "N.m", "Nm", "N·m", "N-m"), "N m"),
    **dict.fromkeys(("rad s-1", "rad s^-1", "rad.s-1", "rad*s^-1"), "rad/s"),
    **dict.fromkeys(("m s-1", "m s^-1", "m.s-1", "m*s^-1"), "m/s"),
}
"""Other spellings of the format's units."""


def same_unit(given: object, wanted: str) -> bool:
    """Return whether an attribute `units` means the unit that the format has."""
    spelling = str(given).strip()
    return SPELLINGS.get(spelling, spelling) == wanted
