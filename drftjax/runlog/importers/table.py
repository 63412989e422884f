"""Import of CSV and TSV tables as run logs, by a mapping."""

import csv
import gzip
import json
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from io import TextIOWrapper
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.common.structured_files import HDF5
from drftjax.runlog.importers import units
from drftjax.runlog.importers.base import ImportedRun
from drftjax.runlog.importers.mapping import (
    Condition,
    Mapping,
    MeasuredMap,
    SetupMap,
    Source,
    read_mapping,
    sources,
)
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog
from drftjax.runlog.schema import SETUP_UNITS, UNITS
from drftjax.runlog.validation import nearest

ROW_LIMIT: Final = 5_000_000
"""Most rows of a table."""


Reals = NDArray[np.float64]


_ENDING: Final = re.compile(r"(\.(csv|tsv|txt|dat))?(\.gz)?$", re.IGNORECASE)


@dataclass(frozen=True)
class Table:
    """Cells of a table as text, with the line of the file for each row."""

    path: Path
    headings: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]

    def position(self, column: str) -> int:
        """Index of a column.

        Raises:
            InputError: there is no such heading; names the nearest ones.
        """
        if column not in self.headings:
            raise InputError(
                f"{self.path}: there is no column {column!r}; {nearest(column, self.headings)}"
            )
        return self.headings.index(column)

    def cells(self, column: str) -> list[str]:
        """Cells of a column as text."""
        position = self.position(column)
        return [row[position] for row in self.rows]

    def numbers(self, column: str) -> Reals:
        """Cells of a column as numbers, shape (rows,).

        Raises:
            InputError: names the line of the first cell that is not a finite number.
        """
        cells = self.cells(column)
        values = np.array([_number(cell) for cell in cells])
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            place = f"{self.path}, line {self.lines[bad[0]]}"
            cell = cells[bad[0]]
            raise InputError(f"{place}: {column} is {cell!r}, it must be a finite number")
        return values

    def select_rows(self, rows: Sequence[int]) -> "Table":
        """Table of some of the rows, in the given order."""
        chosen = ([self.rows[i] for i in rows], [self.lines[i] for i in rows])
        return Table(self.path, self.headings, *chosen)


def import_table(path: str | Path, mapping_path: str | Path) -> list[RunLog]:
    """Read the runs of a CSV or TSV table (also .gz) by a mapping.

    Args:
        path: The table.
        mapping_path: The mapping, a TOML file; see docs/guide/import-data.md.

    Raises:
        InputError: names the file, and the line or the place in the mapping that is wrong.
    """
    return [each.run for each in import_named_runs(path, mapping_path)]


def import_named_runs(path: str | Path, mapping_path: str | Path | None) -> list[ImportedRun]:
    """`import_table`, with the name that the mapping gives the file of each run."""
    if mapping_path is None:
        raise InputError(f"{path}: give --mapping, which says what the columns of a table mean")
    path, mapping_path = Path(path), Path(mapping_path)
    mapping = read_mapping(mapping_path)
    if mapping.files and not any(fnmatch(path.name, pattern) for pattern in mapping.files):
        wanted = " or ".join(mapping.files)
        raise InputError(f"{mapping_path} is for {wanted}, not for {path.name}")
    table = read_table(path, mapping.separator, mapping.skip_lines)
    for source in sources(mapping).values():
        if source.column is not None:
            table.position(source.column)
    selected = _selected(table, mapping)
    return [_run(each, mapping, mapping_path) for each in _runs(selected, mapping)]


# What else may stand between cells than was taken.
SEPARATORS = (";", "\t", ",", "|")


def read_table(path: Path, separator: str | None = None, skip_lines: int = 0) -> Table:
    """Read the headings and cells of a table.

    Args:
        path: CSV or TSV file, also packed as .gz.
        separator: Character between cells; by the suffix where it is None.
        skip_lines: Number of lines above the headings.

    Raises:
        InputError: names the file, the line and what must hold.
    """
    plain = path.name.removesuffix(".gz")
    separator = separator or ("\t" if plain.endswith((".tsv", ".txt")) else ",")
    opened = gzip.open if path.suffix == ".gz" else open
    try:
        with opened(path, "rb") as raw, TextIOWrapper(raw, "utf-8-sig", newline="") as text:
            for line in range(skip_lines):
                if not text.readline():
                    raise InputError(
                        f"{path}: has {line} lines, but skip_lines is {skip_lines}; "
                        "the headings must come after it"
                    )
            return _parsed(path, csv.reader(text, delimiter=separator), skip_lines)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path}: the table cannot be read: {reason}") from error
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: the table is damaged: {error}") from error
    except UnicodeDecodeError as error:
        what = (
            "is an HDF5 file" if error.object.startswith(HDF5) else "is not a table of UTF-8 text"
        )
        raise InputError(f"{path}: {what}; must be CSV or TSV") from error
    except csv.Error as error:
        raise InputError(f"{path}: is not a table of UTF-8 text: {error}") from error


def _parsed(path: Path, reader: "Iterator[list[str]]", skipped: int) -> Table:
    """Table from the rows of a reader, all of which must have a cell for each heading."""
    headings = tuple(cell.strip() for cell in next(reader, []))
    if not any(headings):
        raise InputError(f"{path}: line {skipped + 1} must hold the headings, but it is empty")
    other = next((each for each in SEPARATORS if each in headings[0]), None)
    if len(headings) == 1 and other is not None:
        raise InputError(
            f"{path}: its headings are one cell, {headings[0]!r}; if {other!r} stands between "
            f"cells, write separator = {json.dumps(other)} in the mapping"
        )
    twice = next((name for name in headings if headings.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: the heading {twice!r} stands over two columns")
    rows: list[list[str]] = []
    lines: list[int] = []
    for row in reader:
        if not row:
            continue
        line = skipped + reader.line_num  # pyright: ignore[reportAttributeAccessIssue]
        if len(row) != len(headings):
            raise InputError(
                f"{path}, line {line}: has {len(row)} cells under {len(headings)} headings"
            )
        if len(rows) == ROW_LIMIT:
            raise InputError(f"{path}: has more than {ROW_LIMIT} rows; split it")
        rows.append(row)
        lines.append(line)
    return Table(path, headings, rows, lines)


def _selected(table: Table, mapping: Mapping) -> Table:
    """Rows that meet all conditions of the mapping."""
    keep = np.ones(len(table.rows), dtype=bool)
    for column, condition in mapping.select.items():
        keep &= _meets(table, column, condition)
    if not keep.any():
        chosen = " and ".join(mapping.select) or "any condition"
        raise InputError(f"{table.path}: no row is selected by {chosen}")
    return table.select_rows([int(row) for row in np.flatnonzero(keep)])


def _meets(table: Table, column: str, condition: Condition) -> NDArray[np.bool_]:
    """Truth of a condition by row."""
    meets = np.ones(len(table.rows), dtype=bool)
    wanted = list(condition.one_of or [])
    if condition.equals is not None:
        wanted.append(condition.equals)
    if wanted:
        meets &= np.logical_or.reduce([_equals(table, column, each) for each in wanted])
    if condition.start is not None:
        meets &= table.numbers(column) >= condition.start
    if condition.to is not None:
        meets &= table.numbers(column) <= condition.to
    return meets


def _equals(table: Table, column: str, wanted: float | str) -> NDArray[np.bool_]:
    """Truth by row of equality to a text or a number."""
    if isinstance(wanted, str):
        return np.array([cell.strip() == wanted for cell in table.cells(column)], dtype=bool)
    return table.numbers(column) == wanted


def _runs(table: Table, mapping: Mapping) -> Iterator[Table]:
    """Rows of each run, runs in the order of their first rows."""
    if mapping.rows == "steady":
        yield from (table.select_rows([row]) for row in range(len(table.rows)))
        return
    keys = zip(*(table.cells(column) for column in mapping.group_by), strict=True)
    groups: dict[tuple[str, ...], list[int]] = {}
    if not mapping.group_by:
        groups[()] = list(range(len(table.rows)))
    for row, key in enumerate(keys):
        groups.setdefault(key, []).append(row)
    yield from map(table.select_rows, groups.values())


def _run(table: Table, mapping: Mapping, mapping_path: Path) -> ImportedRun:
    """Run log of the rows of one run."""
    try:
        title = _filled(mapping.title, table)
        made = RunLog(
            setup=_setup(table, mapping.setup),
            command=_command(table, mapping),
            measured=_measured(table, mapping),
            source=mapping.source,
            title=title,
            notes=mapping.notes,
        )
        return ImportedRun(_filled(mapping.name or mapping.title, table), made)
    except InputError as error:
        if str(error).startswith(str(table.path)):
            raise
        rows = f"{table.path}, lines {table.lines[0]}-{table.lines[-1]}"
        raise InputError(f"{rows}, by {mapping_path.name}: {error}") from error


def _filled(pattern: str, table: Table) -> str:
    """Pattern with each {heading} replaced by the cell of the first row."""
    cells = {name: table.rows[0][i].strip() for i, name in enumerate(table.headings)}
    cells |= {"file": _ENDING.sub("", table.path.name)}

    def cell(match: re.Match[str]) -> str:
        """Cell of the heading in braces."""
        if match[1] not in cells:
            hint = nearest(match[1], tuple(cells))
            raise InputError(f"{pattern!r} names no column {match[1]!r}; {hint}")
        return cells[match[1]]

    return re.sub(r"\{([^{}]*)\}", cell, pattern)


def _command(table: Table, mapping: Mapping) -> RecordedCommand:
    """Commands of a run; a steady one holds its command for its duration."""
    given, wanted = mapping.command, UNITS["command"]
    omega = _values(table, given.omega, "command.omega", wanted["omega"])
    vx = given.vx and _values(table, given.vx, "command.vx", wanted["vx"])
    if mapping.duration is None:
        return RecordedCommand(_time(table, mapping), omega, vx)
    held = np.array([0.0, _duration(mapping)])
    return RecordedCommand(held, np.repeat(omega, 2), None if vx is None else np.repeat(vx, 2))


def _measured(table: Table, mapping: Mapping) -> Measured:
    """Measurements of a run; of a steady one, its mean at the end."""
    steady = mapping.duration is not None
    time = np.array([_duration(mapping)]) if steady else _time(table, mapping)
    channels = {
        name: _values(table, source, f"measured.{name}", UNITS["measured"][name])
        for name in MeasuredMap.__struct_fields__
        if (source := getattr(mapping.measured, name)) is not None
    }
    return Measured(time, **channels)


def _setup(table: Table, given: SetupMap) -> RecordedSetup:
    """Set-up of a run, columns averaged over its rows."""
    known: dict[str, float] = {}
    for name in SetupMap.__struct_fields__:
        value = getattr(given, name)
        if value is None:
            continue
        source = value if isinstance(value, Source) else Source(constant=value)
        values = _values(table, source, f"setup.{name}", SETUP_UNITS[name])
        known[name] = float(values.mean())
    return RecordedSetup(**known)  # pyright: ignore[reportArgumentType]


def _time(table: Table, mapping: Mapping) -> Reals:
    """Time of each row [s]."""
    assert mapping.time is not None
    return _values(table, mapping.time, "time", "s")


def _duration(mapping: Mapping) -> float:
    """Duration of a steady run [s]."""
    assert mapping.duration is not None
    value = _in_unit("duration", units.quantity(mapping.duration), "s", mapping.duration)
    if value <= 0:
        raise InputError(f"duration is {value:g} s, it must be above 0")
    return value


def _values(table: Table, source: Source, place: str, wanted: str) -> Reals:
    """Values of a source in SI, shape (rows,)."""
    if source.column is not None:
        raw, of = table.numbers(source.column), units.unit(source.unit or wanted)
    else:
        assert source.constant is not None
        of = units.quantity(source.constant)
        raw = np.ones(len(table.rows))
        if not isinstance(source.constant, str) and source.divide_by is None:
            of = units.Unit(of.factor, units.unit(wanted).powers)
    if source.divide_by is not None:
        of = units.divide(of, units.quantity(source.divide_by))
    values = source.sign * raw * _in_unit(place, of, wanted, None)
    if source.average:
        values = np.full_like(values, values.mean())
    if source.zero_at_first_row:
        values = values - values[0]
    if source.offset is not None:
        offset = units.quantity(source.offset)
        values = values + _in_unit(f"{place}.offset", offset, wanted, source.offset)
    return values


def _in_unit(place: str, given: units.Unit, wanted: str, written: float | str | None) -> float:
    """Value of a quantity in SI; refused where its unit is of another kind than `wanted`."""
    bare = written is not None and not isinstance(written, str)
    powers = units.unit(wanted).powers
    if not bare and given.powers != powers:
        found = units.describe(given.powers)
        raise InputError(f"{place} comes out in {found}, it must come out in {wanted}")
    return given.factor


def _number(cell: str) -> float:
    """Cell as a number; NaN where it is none."""
    try:
        # Python would read 1_7 as 17.
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan
