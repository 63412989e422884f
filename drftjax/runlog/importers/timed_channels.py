"""Channels of a run from the columns of its tables: values in SI, each on its own time axis."""

from collections.abc import Mapping as Named

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.importers.mapping import Clock, Mapping, Source, clock_of, sources
from drftjax.runlog.importers.one_clock import TimedChannel, on_one_clock, pauses
from drftjax.runlog.importers.table import Reals, Table
from drftjax.runlog.importers.tables import Tables
from drftjax.runlog.importers.timestamps import Stamps, in_seconds, stamps
from drftjax.runlog.schema import UNITS

_Axis = tuple[int, Clock]


class TimedColumns:
    """Columns of a run with their times, all counted from one zero.

    Args:
        tables: Rows of the run.
        mapping: Meaning of its columns.

    Raises:
        InputError: names the place of a cell that is no time.
    """

    def __init__(self, tables: Tables, mapping: Mapping) -> None:
        self._tables, self._mapping = tables, mapping
        read: dict[_Axis, Stamps] = {}
        for place, source in sources(mapping).items():
            if source.column is None or place.startswith("setup"):
                continue
            table, _ = tables.find(source.column)
            axis = self._axis(table, source)
            if axis not in read:
                read[axis] = self._stamps(table, axis[1])
        self._times = dict(zip(read, in_seconds(list(read.values())), strict=True))

    def together(
        self,
        title: str,
        given: Named[str, Source],
        clock: str | None,
        constants_at: Reals | None = None,
    ) -> tuple[Reals, dict[str, Reals], list[str]]:
        """Channels of a group on one time axis.

        Args:
            title: Name of the group.
            given: Source of each channel.
            clock: Channel whose times are kept, as in `on_one_clock`.
            constants_at: Times of channels that are all constant [s].

        Returns:
            Times [s], values by channel in SI, and a sentence for each loss.

        Raises:
            InputError: names the place of a time or value that cannot be used.
        """
        wanted = {name: (f"{title}.{name}", UNITS[title][name]) for name in given}
        columns = {name: each for name, each in given.items() if each.column is not None}
        timed = {name: self._channel(each, *wanted[name]) for name, each in columns.items()}
        losses: list[str] = []
        if timed:
            time, values, losses = on_one_clock(timed, clock)
            # A command holds between its rows, so its pauses are bridged by every reader.
            losses += pauses(timed) if title == "command" else []
        elif constants_at is not None:
            time, values = constants_at, {}
        else:
            raise InputError(f"[{title}] must have one column at least, not constants alone")
        for name, each in given.items():
            if each.column is None:
                values[name] = np.full_like(time, in_si(self._tables, each, *wanted[name])[0])
        return time, values, losses

    def _channel(self, source: Source, place: str, wanted: str) -> TimedChannel:
        """Values and times of a column, without the rows that have a gap."""
        assert source.column is not None
        table, heading = self._tables.find(source.column)
        time = self._times[self._axis(table, source)]
        values = in_si(self._tables, source, place, wanted)
        rows = np.flatnonzero(~np.isnan(values))
        if not rows.size:
            raise InputError(f"{self._tables.extent()}: {heading} has no number in any row")
        untimed = rows[np.isnan(time[rows])]
        if untimed.size:
            clock = clock_of(source, self._mapping)
            assert clock.column is not None
            stamp = self._tables.heading_in(table, clock.column)
            assert stamp is not None
            row, must = int(untimed[0]), f"be a time, since {heading} has a value"
            raise InputError(table.explain(row, stamp, must))
        _require_increasing(table, rows, time[rows])
        return TimedChannel(time[rows], values[rows])

    def _axis(self, table: Table, source: Source) -> _Axis:
        """Key of the time axis of a source."""
        return self._tables.tables.index(table), clock_of(source, self._mapping)

    def _stamps(self, table: Table, clock: Clock) -> Stamps:
        """Times of a table's rows."""
        heading = None
        if clock.column is not None:
            heading = self._tables.heading_in(table, clock.column)
            if heading is None:
                other, _ = self._tables.find(clock.column)
                raise InputError(
                    f"{table.path}: the times {clock.column!r} are in another table"
                    f"{other.name and ' ' + repr(other.name)} of {len(other)} rows, not beside "
                    f"{', '.join(table.headings[:3])} with {len(table)}; give these columns a time"
                )
        return stamps(table, clock, heading)


def in_si(tables: Tables, source: Source, place: str, wanted: str) -> Reals:
    """Values of a source in SI; NaN for a gap.

    Args:
        tables: Rows of the run.
        source: Its column or constant.
        place: Its place in the mapping.
        wanted: Unit that comes out.

    Returns:
        Values on the rows of the column's table, or one value of a constant.

    Raises:
        InputError: names the cell that is no number, or the unit that is of another kind.
    """
    if source.column is not None:
        table, heading = tables.find(source.column)
        raw = table.numbers(heading)
        of = units.unit(source.unit or table.units.get(heading) or wanted)
    else:
        assert source.constant is not None
        of = units.quantity(source.constant)
        raw = np.ones(1)
        if not isinstance(source.constant, str) and source.divide_by is None:
            of = units.Unit(of.factor, units.unit(wanted).powers)
    if source.divide_by is not None:
        of = units.divide(of, units.quantity(source.divide_by))
    values = source.sign * raw * si_factor(place, of, wanted, None)
    known = np.flatnonzero(~np.isnan(values))
    if source.average and known.size:
        values = np.where(np.isnan(values), np.nan, values[known].mean())
    if source.zero_at_first_row and known.size:
        values = values - values[known[0]]
    if source.offset is not None:
        offset = units.quantity(source.offset)
        values = values + si_factor(f"{place}.offset", offset, wanted, source.offset)
    return values


def si_factor(place: str, given: units.Unit, wanted: str, written: float | str | None) -> float:
    """Value of a quantity in SI; refused where its unit is of another kind than `wanted`.

    Args:
        place: Its place in the mapping.
        given: The quantity.
        wanted: Unit that it must come out in.
        written: Its text or number in the mapping; a bare number is in SI.

    Raises:
        InputError: the units are of another kind.
    """
    bare = written is not None and not isinstance(written, str)
    if not bare and given.powers != units.unit(wanted).powers:
        found = units.describe(given.powers)
        raise InputError(f"{place} comes out in {found}, it must come out in {wanted}")
    return given.factor


def _require_increasing(table: Table, rows: "np.ndarray", time: Reals) -> None:
    """Refuse rows that do not follow one another in time, with their lines.

    Raises:
        InputError: names the first such line, and how many there are.
    """
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if wrong.size:
        before, at = int(rows[wrong[0]]), int(rows[wrong[0] + 1])
        raise InputError(
            f"{table.place(at)}: time must increase from row to row, but is {time[wrong[0] + 1]:g} "
            f"s after {time[wrong[0]]:g} s in {table.row_word} {table.lines[before]} "
            f"({wrong.size} such rows); mend them, or, if several runs follow one another, give "
            "group_by"
        )
