"""Mapping files (TOML), which define the meaning of the columns of a table."""

import re
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.structured_files import explain, read_document
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.validation import nearest

Quantity = float | str
"""A number in SI, or text with its unit such as "62.5 mm"."""

Heading = str | int
"""Heading of a column, or its number from 1."""


class Clock(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Time axis of rows.

    Attributes:
        column: Column of the times; or
        interval: even interval of rows that carry no time.
        unit: Unit of the column, "iso8601" for dates, or a pattern such as "%d.%m.%Y %H:%M:%S.%f";
            the file's own, or s, where it is None.
        zero_at_first_row: True where the times are counted from the run's first row; axes that say
            so share the earliest.
        offset: Added last.
    """

    column: Heading | None = None
    interval: Quantity | None = None
    unit: str | None = None
    zero_at_first_row: bool = False
    offset: Quantity | None = None


class Source(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Origin of one channel or of one number of the set-up.

    Attributes:
        column: Column, by its heading or its number; or
        constant: one value for all rows.
        unit: Unit of the column; the file's own, or SI, where it is None.
        time: Time axis of this column, or its heading; that of [time] where it is None.
        sign: -1 where the table counts in the opposite direction.
        divide_by: Divisor, such as the radius for a rim speed or gravity for a weight.
        offset: Added last, in the direction of the channel.
        average: True where every row gets the mean over the run's rows.
        zero_at_first_row: True where the run's first value is subtracted.
    """

    column: Heading | None = None
    constant: Quantity | None = None
    unit: str | None = None
    time: Clock | Heading | None = None
    sign: Literal[1, -1] = 1
    divide_by: Quantity | None = None
    offset: Quantity | None = None
    average: bool = False
    zero_at_first_row: bool = False


class Condition(msgspec.Struct, forbid_unknown_fields=True, frozen=True, rename={"start": "from"}):
    """Selection of rows by one column, in the column's own unit; limits are included."""

    equals: float | str | None = None
    one_of: list[float | str] | None = None
    start: float | None = None
    to: float | None = None


class CommandMap(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Columns of /command; without vx the carriage ran free."""

    omega: Source
    vx: Source | None = None


class MeasuredMap(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Columns of /measured; None for a channel that was not measured."""

    x: Source | None = None
    z: Source | None = None
    fx: Source | None = None
    fz: Source | None = None
    torque: Source | None = None


Given = Quantity | Source


class SetupMap(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Numbers of /setup, each a quantity, or a source whose mean over the run's rows is taken."""

    wheel_radius: Given | None = None
    wheel_width: Given | None = None
    grouser_count: Given | None = None
    grouser_height: Given | None = None
    grouser_thickness: Given | None = None
    mass_x: Given | None = None
    mass_z: Given | None = None
    gravity: Given | None = None
    bulk_density: Given | None = None
    sinkage_static: Given | None = None
    scaling_factor_initial: Given | None = None


class Mapping(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Contents of a mapping file.

    Attributes:
        rows: "samples" where the rows of a run follow one another in time; "steady" where each row
            is the mean of a run of its own.
        title: Title of a run; {heading} is replaced by that column's cell, {file} by the table's
            name without its suffix.
        command: Columns of /command.
        measured: Columns of /measured.
        setup: Numbers of /setup.
        name: Name of a run's file, with the same braces; the title where it is None.
        files: Patterns of the names of the tables that this mapping is for; any where it is empty.
        source: Source of the run log.
        notes: Notes of every run.
        separator, decimal, encoding, skip_lines, skip_below, headings, end_at, sheet: As in
            `Layout`.
        group_by: Columns whose cells together identify a run.
        duration: Time for which a steady run holds its command, and at whose end its mean is put.
        select: Conditions by column, all of which must hold.
        time: Time of a row; None for steady rows, and where each channel has its own.
        clock: Channel whose times the run keeps, where the channels have different ones; the one
            with the fewest values where it is None.
    """

    rows: Literal["samples", "steady"]
    title: str
    command: CommandMap
    measured: MeasuredMap
    setup: SetupMap = SetupMap()
    name: str | None = None
    files: list[str] = []
    source: str = "measured"
    notes: str | None = None
    separator: str | None = None
    decimal: str = "."
    encoding: str | None = None
    skip_lines: int = 0
    skip_below: int = 0
    headings: bool = True
    end_at: str | None = None
    sheet: str | None = None
    group_by: list[str] = []
    duration: Quantity | None = None
    select: dict[str, Condition] = {}
    time: Clock | None = None
    clock: str | None = None

    def layout(self) -> Layout:
        """Place of the headings and rows.

        Raises:
            InputError: a sign or a number cannot be one.
        """
        return Layout(**{each.name: getattr(self, each.name) for each in fields(Layout)})


_PARTS: Final = (Mapping, Clock, Source, Condition, CommandMap, MeasuredMap, SetupMap)


_UNKNOWN: Final = re.compile(r"unknown field `(.+?)`(?: - at `\$\.?(.*)`)?")


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Raises:
        InputError: names the file, the place in it and what must hold.
    """
    document = read_document(path)
    try:
        mapping = msgspec.convert(document, Mapping)
        _require_whole(mapping)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {_explain(str(error))}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return mapping


def sources(mapping: Mapping) -> dict[str, Source]:
    """All given sources by their place in the mapping, such as "command.omega"."""
    found: dict[str, Any] = {}
    for title in ("command", "measured", "setup"):
        part = getattr(mapping, title)
        found |= {f"{title}.{name}": getattr(part, name) for name in part.__struct_fields__}
    return {place: each for place, each in found.items() if isinstance(each, Source)}


def clocks(mapping: Mapping) -> dict[str, Clock]:
    """All time axes by their place in the mapping."""
    found = {} if mapping.time is None else {"time": mapping.time}
    for place, each in sources(mapping).items():
        if each.time is not None:
            found[f"{place}.time"] = clock_of(each, mapping)
    return found


def clock_of(source: Source, mapping: Mapping) -> Clock:
    """Time axis of a source; a heading alone is a column that is otherwise like [time]."""
    if isinstance(source.time, Clock):
        return source.time
    assert source.time is not None or mapping.time is not None
    shared = mapping.time or Clock()
    if source.time is None:
        return shared
    return msgspec.structs.replace(shared, column=source.time, interval=None)


def _require_whole(mapping: Mapping) -> None:
    """Check the rules of a mapping that its types do not express."""
    steady = mapping.rows == "steady"
    if steady and (mapping.duration is None or mapping.time is not None):
        raise InputError("steady rows need a duration and have no [time]")
    if not steady and mapping.duration is not None:
        raise InputError("rows that are samples have no duration")
    timed = [*sources(mapping).items()]
    if not steady and mapping.time is None:
        own = [each.time for place, each in timed if each.column and not place.startswith("setup")]
        if not own or None in own:
            raise InputError("rows that are samples need a [time], or each channel a time")
    if steady and mapping.group_by:
        raise InputError("steady rows are a run each, so they have no group_by")
    mapping.layout()
    if not any(getattr(mapping.measured, name) for name in MeasuredMap.__struct_fields__):
        raise InputError(f"[measured] must have one of {', '.join(MeasuredMap.__struct_fields__)}")
    for column, condition in mapping.select.items():
        if condition.one_of == []:
            raise InputError(f"select.{column}.one_of is empty, so no row could meet it")
        if condition == Condition():
            raise InputError(f"select.{column} must have equals, one_of, from or to")
    for place, each in clocks(mapping).items():
        if (each.column is None) == (each.interval is None):
            raise InputError(f"{place} must have either a column or an interval")
    for place, each in timed:
        if (each.column is None) == (each.constant is None):
            raise InputError(f"{place} must have either a column or a constant")
        if each.constant is not None and each.unit is not None:
            raise InputError(f"{place}: write a constant's unit with it, like '10 mm/s'")
        if each.time is not None and (each.column is None or steady or place.startswith("setup")):
            raise InputError(f"{place} has a time, which only a column of samples can have")


def _explain(message: str) -> str:
    """Rewrite msgspec's message, with the nearest keys for an unknown one."""
    unknown = _UNKNOWN.search(message)
    if unknown is None:
        return explain(message, Mapping)
    keys = {name for part in _PARTS for name in part.__struct_encode_fields__} - {unknown[1]}
    place = f" in [{unknown[2]}]" if unknown[2] else ""
    return f"there is no key {unknown[1]!r}{place}; {nearest(unknown[1], sorted(keys))}"
