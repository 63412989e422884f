"""Time axes of tables: clocks in any unit from any zero, dates, and rows at an even interval."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.importers.mapping import Clock, Quantity
from drftjax.runlog.importers.table import GAPS, ISO, Reals, Table

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

_NANOSECOND: Final = 1e-9

_FRACTION: Final = re.compile(r"[.,]\d{6}(\d{1,3})")
"""Digits of a second beyond the six that `datetime` keeps."""


@dataclass(frozen=True)
class Stamps:
    """Times of a table's rows as the file has them.

    Attributes:
        counts: Whole numbers where the clock counts them, else real numbers, shape (rows,).
        factor: One count [s].
        valid: False for rows without a time, shape (rows,).
        clock: Their description in the mapping.
    """

    counts: NDArray[Any]
    factor: float
    valid: NDArray[np.bool_]
    clock: Clock


def stamps(table: Table, clock: Clock, heading: str | None) -> Stamps:
    """Read the times of a table.

    Args:
        table: Its rows.
        clock: Unit and zero of the times.
        heading: Column of the times; None where the clock gives the interval of the rows.

    Raises:
        InputError: names the place of a cell that is no time, or the unit that is none of time.
    """
    if heading is None:
        assert clock.interval is not None
        interval = _seconds("time.interval", clock.interval)
        if interval <= 0:
            raise InputError(f"time.interval is {interval:g} s, it must be above 0")
        # The rows of a selection keep their places in the file.
        first = table.lines[0] if len(table) else 0
        counts = np.asarray(table.lines, dtype=np.int64) - first
        return Stamps(counts, interval, np.ones(len(table), dtype=bool), clock)
    unit = clock.unit or table.units.get(heading) or "s"
    if unit == ISO or "%" in unit:
        counts, valid = _dates(table, heading, unit)
        return Stamps(counts, _NANOSECOND, valid, clock)
    of = units.unit(unit)
    if of.powers != units.unit("s").powers:
        raise InputError(f"time comes out in {units.describe(of.powers)}, it must come out in s")
    counts, valid = _counts(table, heading)
    return Stamps(counts, of.factor, valid, clock)


def in_seconds(axes: Sequence[Stamps]) -> list[Reals]:
    """Times of several axes in seconds, NaN where a row has none.

    Axes that begin at the first row share one zero, the earliest of their first times, so that
    sensors which start one after the other stay apart.
    """
    zeroed = [each for each in axes if each.clock.zero_at_first_row and each.valid.any()]
    first = min(zeroed, key=lambda each: _start(each) * each.factor, default=None)
    return [_seconds_of(each, first) for each in axes]


def _seconds_of(axis: Stamps, first: Stamps | None) -> Reals:
    """Times of one axis [s], from the start of `first` where the axis is to begin there."""
    counts, shift = axis.counts, 0.0
    if axis.clock.zero_at_first_row and first is not None:
        if axis.factor == first.factor:
            # Whole counts since 1970 have more digits than a real number holds.
            counts = counts - _start(first)
        else:
            shift = -float(_start(first)) * first.factor
    seconds = np.where(axis.valid, counts * axis.factor + shift, np.nan)
    if axis.clock.offset is not None:
        seconds = seconds + _seconds("time.offset", axis.clock.offset)
    return seconds


def _start(axis: Stamps) -> Any:
    """First count of an axis."""
    return axis.counts[int(np.argmax(axis.valid))]


def _seconds(place: str, given: Quantity) -> float:
    """Quantity of time [s]; a bare number is in seconds."""
    value = units.quantity(given)
    if isinstance(given, str) and value.powers != units.unit("s").powers:
        found = units.describe(value.powers)
        raise InputError(f"{place} comes out in {found}, it must come out in s")
    return value.factor


def _counts(table: Table, heading: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Numbers of a clock, whole ones exactly, and the rows that have one."""
    values = table.numbers(heading)
    valid = np.isfinite(values)
    cells = table.column(heading)
    if isinstance(cells, np.ndarray):
        return (cells if cells.dtype.kind in "iu" else np.nan_to_num(values)), valid
    try:
        whole = [int(cell) if fine else 0 for cell, fine in zip(cells, valid, strict=True)]
        return np.array(whole, dtype=np.int64), valid
    except (ValueError, OverflowError):
        return np.nan_to_num(values), valid


def _dates(table: Table, heading: str, unit: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Nanoseconds since 1970, or since midnight, and the rows that have a date."""
    cells = [cell.strip() for cell in table.cells(heading)]
    valid = np.array([cell.lower() not in GAPS for cell in cells], dtype=bool)
    counts = np.zeros(len(cells), dtype=np.int64)
    for row in np.flatnonzero(valid):
        try:
            counts[row] = _nanoseconds(cells[row], unit)
        except (ValueError, OverflowError):
            form = "an ISO 8601 date" if unit == ISO else f"a time of the form {unit}"
            where = table.place(int(row))
            raise InputError(f"{where}: {heading} is {cells[row]!r}, it must be {form}") from None
    return counts, valid


def _nanoseconds(cell: str, unit: str) -> int:
    """One date as nanoseconds since 1970 in UTC, or a time of day as those since midnight."""
    beyond = 0
    if unit == ISO:
        match = _FRACTION.search(cell)
        beyond = int(match[1].ljust(3, "0")) if match else 0
        try:
            moment = datetime.fromisoformat(cell)
        except ValueError:
            moment = datetime.combine(_EPOCH.date(), time.fromisoformat(cell))
    else:
        moment = datetime.strptime(cell, unit)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    past = moment - _EPOCH
    seconds = past.days * 86400 + past.seconds
    return (seconds * 1_000_000 + past.microseconds) * 1000 + beyond
