"""Mapping proposed for a file: its text, with a remark wherever it is unsure."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.importers.guess.channels_guess import (
    KINDS,
    GuessedChannel,
    Reals,
    guess_channel,
    guess_omega,
    guess_time,
)
from drftjax.runlog.importers.guess.rows_guess import guess_layout
from drftjax.runlog.importers.guess.words import LIKELY, NamedColumn, score, taken_apart
from drftjax.runlog.importers.mapping import Clock
from drftjax.runlog.importers.readers.registry import read_tables_of
from drftjax.runlog.importers.table import ISO, Table
from drftjax.runlog.importers.timestamps import stamps
from drftjax.runlog.schema import SETUP_UNITS

_UNIT_BONUS: Final = 0.25
"""Weight of a stated unit of the right kind beside a name; it decides between equal names."""

_SETUP: Final = {
    "wheel_radius": "150 mm",
    "wheel_width": "120 mm",
    "mass_z": "18.8 kg",
    "mass_x": "13.9 kg",
    "grouser_count": 12,
    "grouser_height": "18 mm",
    "grouser_thickness": "9 mm",
}


@dataclass(frozen=True)
class Proposal:
    """Mapping proposed for a file.

    Attributes:
        text: TOML, with comments.
        doubts: Sentences on what is unsure, as they stand in the text.
    """

    text: str
    doubts: tuple[str, ...]


@dataclass
class _Column:
    """Column of a table that holds numbers or times."""

    table: Table
    heading: str
    named: NamedColumn
    values: Reals
    is_date: bool = False
    guessed: GuessedChannel | None = field(default=None)


def propose_mapping(path: Path) -> Proposal:
    """Propose a mapping for a file from its headings, units and ranges.

    Args:
        path: File of tables.

    Raises:
        InputError: the file cannot be read, or has no columns of numbers.
    """
    placed = guess_layout(path)
    tables = read_tables_of(path, placed.layout)
    columns = [each for table in tables for each in _columns(table, placed.units)]
    if not columns:
        raise InputError(f"{path}: has no column of numbers, so no mapping can be proposed")
    roles = _roles(columns)
    group, first, told = _runs(tables[0], roles.get("time"), columns)
    _guess_all(roles, first)
    lines = _Lines(path, len(tables) > 1)
    lines.layout(placed.layout.set_keys(), placed.layout)
    lines.note(*placed.doubts, *told)
    lines.head(group)
    lines.time(roles.get("time"))
    used = {id(each) for each in roles.values()}
    left = [each for each in columns if id(each) not in used and each.heading not in group]
    if "omega" not in roles:
        speed = units.unit("m/s").powers
        stated = [each for each in left if each.named.unit is not None]
        rims = [each for each in stated if units.unit(each.named.unit or "").powers == speed]
        lines.rim_speed = next(iter(rims), None)
    lines.channels("command", {name: roles.get(name) for name in ("omega", "vx")})
    lines.channels("measured", {name: roles.get(name) for name in ("x", "z", "fx", "fz", "torque")})
    lines.unused(left)
    lines.setup()
    return Proposal("\n".join(lines.lines) + "\n", tuple(lines.doubts))


def _columns(table: Table, unit_cells: Sequence[str]) -> list[_Column]:
    """Columns of a table that hold numbers or dates."""
    found = []
    for at, heading in enumerate(table.headings):
        unit = unit_cells[at] if at < len(unit_cells) else table.units.get(heading, "")
        named = taken_apart(heading, unit)
        for clock in (None, Clock(unit=ISO)):
            try:
                if clock is None:
                    values, dated = table.numbers(heading), False
                else:
                    read = stamps(table, clock, heading)
                    values, dated = np.where(read.valid, read.counts * read.factor, np.nan), True
            except InputError:
                continue
            if np.isfinite(values).any():
                found.append(_Column(table, heading, named, values, dated))
            break
    return found


def _roles(columns: Sequence[_Column]) -> dict[str, _Column]:
    """Column of each channel, the surest first."""
    ranked = sorted(
        ((_score(role, each), -at, role) for role in KINDS for at, each in enumerate(columns)),
        reverse=True,
    )
    roles: dict[str, _Column] = {}
    taken: set[int] = set()
    for points, minus, role in ranked:
        if points >= LIKELY and role not in roles and -minus not in taken:
            roles[role] = columns[-minus]
            taken.add(-minus)
    if "omega" not in roles and "vx" in roles and roles["vx"].named.unit is None:
        roles["omega"] = roles.pop("vx")
    return roles


def _score(role: str, column: _Column) -> float:
    """Points of a column for a channel; 0 where its unit is of another kind."""
    if column.is_date:
        return 1.0 if role == "time" else 0.0
    points, unit = score(role, column.named), column.named.unit
    if unit is None:
        return points
    fits = units.unit(unit).powers == units.unit(KINDS[role]).powers
    return points + _UNIT_BONUS if fits and points else 0.0


def _runs(
    table: Table, time: _Column | None, columns: Sequence[_Column]
) -> tuple[list[str], int | None, list[str]]:
    """Columns that tell the runs apart, rows of the first run, and doubts."""
    if time is None or time.table is not table:
        return [], None, []
    again = np.flatnonzero(np.diff(time.values) < 0) + 1
    if not again.size:
        return [], None, []
    for heading in table.headings:
        cells = table.cells(heading)
        changes = [at for at in range(1, len(cells)) if cells[at] != cells[at - 1]]
        if changes == again.tolist():
            told = f"time starts again {again.size} times, where {heading!r} changes"
            return [heading], int(again[0]), [told]
    told = (
        f"{table.place(int(again[0]))}: time goes back ({again.size} such rows); for several runs "
        "give group_by a column that tells them apart"
    )
    return [], int(again[0]), [told]


def _guess_all(roles: Mapping[str, _Column], rows: int | None) -> None:
    """Find out the unit and sign of each channel from the first run."""
    values = {role: each.values[:rows] for role, each in roles.items()}
    time = roles.get("time")
    seconds = None
    if time is not None:
        if time.is_date:
            time.guessed = GuessedChannel(ISO, {"zero_at_first_row": True})
            seconds = values["time"]
        else:
            own = values["time"][np.isfinite(values["time"])]
            time.guessed = guess_time(time.named, own)
            seconds = values["time"] * units.unit(time.guessed.unit).factor
    for role in ("x", "z", "vx", "fx", "fz", "torque"):
        if role in roles:
            own = values[role][np.isfinite(values[role])]
            roles[role].guessed = guess_channel(role, roles[role].named, own)
    if "omega" in roles:
        omega, x = roles["omega"], roles.get("x")
        beside = x is not None and time is not None and x.table is omega.table is time.table
        if beside and x is not None and x.guessed is not None and seconds is not None:
            path = values["x"] * units.unit(x.guessed.unit).factor
            whole = np.isfinite(seconds) & np.isfinite(path) & np.isfinite(values["omega"])
            rows_of = seconds[whole], path[whole], values["omega"][whole]
            omega.guessed = guess_omega(omega.named, rows_of[2], rows_of[0], rows_of[1])
        else:
            own = values["omega"][np.isfinite(values["omega"])]
            omega.guessed = guess_omega(omega.named, own, None, None)


class _Lines:
    """Text of a mapping, line by line."""

    def __init__(self, path: Path, several: bool) -> None:
        self._several = several
        self._time: _Column | None = None
        self.doubts: list[str] = []
        self.rim_speed: _Column | None = None
        self.lines = [
            f"# Proposed by drft log import --guess for {path.name}; look at the lines marked "
            "unsure."
        ]

    def note(self, *doubts: str) -> None:
        """Write doubts as comments."""
        self.lines += [f"# unsure: {each}" for each in doubts]
        self.doubts += doubts

    def layout(self, keys: Sequence[str], layout: object) -> None:
        """Write the keys of the layout that are not the usual ones."""
        self.lines += [f"{key} = {_toml(getattr(layout, key))}" for key in keys]

    def head(self, group: Sequence[str]) -> None:
        """Write title and groups."""
        braces = "".join(f" {{{each}}}" for each in group)
        self.lines += ['rows = "samples"', f"title = {_toml('{file}' + braces)}"]
        if group:
            self.lines.append(f"group_by = {_toml(list(group))}")

    def time(self, column: _Column | None) -> None:
        """Write the time axis."""
        self.lines += ["", "[time]"]
        self._time = column
        if column is None:
            self.note(
                "no column looks like a time; if rows are even, give their interval, and if each "
                'row is the mean of a run, write rows = "steady" and a duration for this table'
            )
            self.lines.append('interval = "10 ms"')
            return
        assert column.guessed is not None
        self.note(*(f"{column.heading!r}: {each}" for each in column.guessed.doubts))
        name = column.heading if self._several else self._name(column)
        entries = {"column": name, "unit": column.guessed.unit, **column.guessed.keys}
        self.lines += [f"{key} = {_toml(value)}" for key, value in entries.items()]

    def channels(self, title: str, columns: Mapping[str, _Column | None]) -> None:
        """Write the channels of a group."""
        self.lines += ["", f"[{title}]"]
        for role, column in columns.items():
            if column is None or column.guessed is None:
                if role == "omega":
                    self.note("no column looks like the wheel's speed; omega must be given")
                    self.lines.append('# omega = { column = "?", unit = "rad/s" }')
                    if self.rim_speed is not None:
                        rim, unit = self._name(self.rim_speed), self.rim_speed.named.unit
                        self.lines += [
                            "# or, from the speed of the rim, over your wheel's radius:",
                            f"# omega = {{ column = {_toml(rim)}, unit = {_toml(unit)}, "
                            'divide_by = "150 mm" }',
                        ]
                continue
            self.note(*(f"{column.heading!r}: {each}" for each in column.guessed.doubts))
            if role == "vx":
                self.note(f"{column.heading!r}: leave vx out where the carriage runs free")
            entries: dict[str, object] = {"column": self._name(column)}
            entries |= {"unit": column.guessed.unit, **column.guessed.keys}
            inside = ", ".join(f"{key} = {_toml(value)}" for key, value in entries.items())
            self.lines.append(f"{role} = {{ {inside} }}")
        if title == "measured" and not any(columns.values()):
            self.note("no column looks like a measurement; one of x, z, fx, fz, torque is needed")

    def unused(self, columns: Sequence[_Column]) -> None:
        """Write the columns that no channel takes."""
        if columns:
            names = ", ".join(repr(each.heading) for each in columns[:20])
            self.lines += [f"# Not taken: {names}{', ...' if len(columns) > 20 else ''}"]

    def setup(self) -> None:
        """Write the numbers of the rig as comments: a table does not have them."""
        self.lines += [
            "",
            "[setup]",
            "# Of your rig; a run is simulated and fitted only with wheel_radius, wheel_width and",
            "# mass_z. Take the # away and write your numbers:",
        ]
        assert SETUP_UNITS.keys() >= _SETUP.keys()
        self.lines += [f"# {name} = {_toml(value)}" for name, value in _SETUP.items()]

    def _name(self, column: _Column) -> str:
        """Name of a column in the mapping."""
        name = column.table.name
        return f"{name}.{column.heading}" if self._several and name else column.heading


def _toml(value: object) -> str:
    """Value in TOML, whose strings, numbers and lists are JSON's here."""
    return json.dumps(value, ensure_ascii=False)
