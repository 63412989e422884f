"""Import of tables as run logs, by a mapping."""

import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.importers.base import ImportedRun
from drftjax.runlog.importers.mapping import (
    Condition,
    Mapping,
    MeasuredMap,
    SetupMap,
    Source,
    clocks,
    read_mapping,
    sources,
)
from drftjax.runlog.importers.readers.registry import read_tables_of, reader_suffixes
from drftjax.runlog.importers.table import Table
from drftjax.runlog.importers.tables import Tables
from drftjax.runlog.importers.timed_channels import TimedColumns, in_si, si_factor
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog
from drftjax.runlog.schema import SETUP_UNITS, UNITS
from drftjax.runlog.validation import nearest

_PLACEHOLDER: Final = re.compile(r"\{([^{}]*)\}")


def import_table(path: str | Path, mapping_path: str | Path) -> list[RunLog]:
    """Read the runs of a file of tables by a mapping.

    Args:
        path: The file; its suffix chooses the reader.
        mapping_path: The mapping, a TOML file; see docs/guide/import-data.md.

    Raises:
        InputError: names the file, and the line or the place in the mapping that is wrong.
    """
    return [each.run for each in import_named_runs(path, mapping_path)]


def import_named_runs(path: str | Path, mapping_path: str | Path | None) -> list[ImportedRun]:
    """`import_table`, with the name that the mapping gives the file of each run, and its losses."""
    if mapping_path is None:
        raise InputError(
            f"{path}: give --mapping, which says what the columns of a table mean; --guess "
            "proposes one"
        )
    path, mapping_path = Path(path), Path(mapping_path)
    mapping = read_mapping(mapping_path)
    if mapping.files and not any(fnmatch(path.name, pattern) for pattern in mapping.files):
        wanted = " or ".join(mapping.files)
        raise InputError(f"{mapping_path} is for {wanted}, not for {path.name}")
    tables = Tables(path, tuple(read_tables_of(path, mapping.layout())))
    for source in sources(mapping).values():
        if source.column is not None:
            tables.find(source.column)
    for clock in clocks(mapping).values():
        if clock.column is not None:
            tables.require(clock.column)
    selected = _selected(tables, mapping)
    return [_run(each, mapping, mapping_path) for each in _runs(selected, mapping)]


def _selected(tables: Tables, mapping: Mapping) -> Tables:
    """Rows that meet all conditions of the mapping, each table by those on its own columns."""
    for column in mapping.select:
        tables.require(column)
    kept = []
    for table in tables.tables:
        keep = np.ones(len(table), dtype=bool)
        for column, condition in mapping.select.items():
            heading = tables.heading_in(table, column)
            if heading is not None:
                keep &= _meets(table, heading, condition)
        kept.append(table if keep.all() else table.select_rows(np.flatnonzero(keep)))
    if not any(len(table) for table in kept):
        chosen = " and ".join(mapping.select) or "any condition"
        raise InputError(f"{tables.path}: no row is selected by {chosen}")
    return Tables(tables.path, tuple(kept))


def _meets(table: Table, column: str, condition: Condition) -> NDArray[np.bool_]:
    """Truth of a condition by row; a gap meets no limit."""
    meets = np.ones(len(table), dtype=bool)
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


def _runs(tables: Tables, mapping: Mapping) -> Iterator[Tables]:
    """Rows of each run, runs in the order of their first rows."""
    if mapping.rows == "samples" and not mapping.group_by:
        yield tables
        return
    table = tables.only("steady rows are" if mapping.rows == "steady" else "group_by is")
    if mapping.rows == "steady":
        groups: Sequence[Sequence[int]] = [[row] for row in range(len(table))]
    else:
        keys = zip(*(table.cells(column) for column in mapping.group_by), strict=True)
        found: dict[tuple[str, ...], list[int]] = {}
        for row, key in enumerate(keys):
            found.setdefault(key, []).append(row)
        groups = list(found.values())
    others = tuple(each for each in tables.tables if each is not table)
    for rows in groups:
        yield Tables(tables.path, (table.select_rows(rows), *others))


def _run(tables: Tables, mapping: Mapping, mapping_path: Path) -> ImportedRun:
    """Run log of the rows of one run."""
    try:
        title = _filled(mapping.title, tables)
        command, measured, losses = _rows(tables, mapping)
        made = RunLog(
            setup=_setup(tables, mapping.setup),
            command=command,
            measured=measured,
            source=mapping.source,
            title=title,
            notes=mapping.notes,
        )
        name = _filled(mapping.name or mapping.title, tables)
        return ImportedRun(name, made, tuple(losses))
    except InputError as error:
        if str(error).startswith(str(tables.path)):
            raise
        raise InputError(f"{tables.extent()}, by {mapping_path.name}: {error}") from error


def _filled(pattern: str, tables: Tables) -> str:
    """Pattern with each {heading} replaced by the cell of the first row."""
    cells = {"file": _stem(tables.path)}
    for table in tables.tables:
        for heading, column in zip(table.headings, table.columns, strict=True):
            if len(column):
                cells.setdefault(heading, table.cells(heading)[0].strip())

    def cell(match: re.Match[str]) -> str:
        """Cell of the heading in braces."""
        if match[1] not in cells:
            hint = nearest(match[1], tuple(cells))
            raise InputError(f"{pattern!r} names no column {match[1]!r}; {hint}")
        return cells[match[1]]

    return _PLACEHOLDER.sub(cell, pattern)


def _stem(path: Path) -> str:
    """Name of a file without its suffix, where that is one of a table."""
    name = path.name
    for ending in (".gz", *reader_suffixes()):
        if name.lower().endswith(ending) and len(name) > len(ending):
            name = name[: -len(ending)]
            if ending != ".gz":
                break
    return name


def _rows(tables: Tables, mapping: Mapping) -> tuple[RecordedCommand, Measured, list[str]]:
    """Commands and measurements of a run, and a sentence for each loss of samples."""
    command = {"omega": mapping.command.omega}
    if mapping.command.vx is not None:
        command["vx"] = mapping.command.vx
    measured = {
        name: source
        for name in MeasuredMap.__struct_fields__
        if (source := getattr(mapping.measured, name)) is not None
    }
    if mapping.duration is not None:
        return *_steady(tables, command, measured, _duration(mapping)), []
    columns = TimedColumns(tables, mapping)
    measured_time, channels, losses = columns.together("measured", measured, mapping.clock)
    time, commands, more = columns.together("command", command, None, measured_time)
    losses += [f"command.{each}" for each in more]
    return RecordedCommand(time, **commands), Measured(measured_time, **channels), losses


def _steady(
    tables: Tables, command: dict[str, Source], measured: dict[str, Source], duration: float
) -> tuple[RecordedCommand, Measured]:
    """Commands held for a time, and the mean at its end; a channel with a gap is left out."""
    held = {
        name: in_si(tables, each, f"command.{name}", UNITS["command"][name])
        for name, each in command.items()
    }
    means = {
        name: in_si(tables, each, f"measured.{name}", UNITS["measured"][name])
        for name, each in measured.items()
    }
    for name, value in held.items():
        if np.isnan(value).any():
            raise InputError(f"command.{name} is a gap; a steady row must have it")
    commands = {name: np.repeat(value, 2) for name, value in held.items()}
    known = {name: value for name, value in means.items() if not np.isnan(value).any()}
    return (
        RecordedCommand(np.array([0.0, duration]), **commands),
        Measured(np.array([duration]), **known),
    )


def _setup(tables: Tables, given: SetupMap) -> RecordedSetup:
    """Set-up of a run, columns averaged over its rows."""
    known: dict[str, float] = {}
    for name in SetupMap.__struct_fields__:
        value = getattr(given, name)
        if value is None:
            continue
        source = value if isinstance(value, Source) else Source(constant=value)
        values = in_si(tables, source, f"setup.{name}", SETUP_UNITS[name])
        if np.isnan(values).all():
            raise InputError(f"setup.{name} has no number in the run's rows")
        known[name] = float(np.nanmean(values))
    return RecordedSetup(**known)  # pyright: ignore[reportArgumentType]


def _duration(mapping: Mapping) -> float:
    """Duration of a steady run [s]."""
    assert mapping.duration is not None
    value = si_factor("duration", units.quantity(mapping.duration), "s", mapping.duration)
    if value <= 0:
        raise InputError(f"duration is {value:g} s, it must be above 0")
    return value
