"""The tables of one file, and the column that a mapping means."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.runlog.importers.table import Table
from drftjax.runlog.validation import nearest

ColumnName = str | int
"""Heading of a column, or its number from 1."""


@dataclass(frozen=True)
class Tables:
    """Tables of one file.

    A column is named by its heading, by its table's name and heading as in "Run 3.speed", or by its
    number from 1 where there is one table.

    Attributes:
        path: The file.
        tables: Its tables, in their order.
    """

    path: Path
    tables: tuple[Table, ...]

    def find(self, column: ColumnName) -> tuple[Table, str]:
        """Table and heading of a column.

        Raises:
            InputError: there is no such column, or there are several.
        """
        found = list(self._all(column))
        if len(found) > 1:
            names = ", ".join(repr(f"{table.name}.{heading}") for table, heading in found)
            raise InputError(f"{self.path}: {column!r} may be one of {names}; write which one")
        if not found:
            raise InputError(f"{self.path}: there is no column {column!r}; {self._nearest(column)}")
        return found[0]

    def require(self, column: ColumnName) -> None:
        """Refuse a column that no table has.

        Raises:
            InputError: names it, and the nearest ones.
        """
        if not any(True for _ in self._all(column)):
            raise InputError(f"{self.path}: there is no column {column!r}; {self._nearest(column)}")

    def heading_in(self, table: Table, column: ColumnName) -> str | None:
        """Heading of a column in one of the tables; None where it has no such column."""
        if isinstance(column, int):
            inside = len(self.tables) == 1 and 1 <= column <= len(table.headings)
            return table.headings[column - 1] if inside else None
        if column in table.headings:
            return column
        short = column.removeprefix(f"{table.name}.")
        return short if table.name and short != column and short in table.headings else None

    def only(self, what: str) -> Table:
        """The sole table of several rows.

        Raises:
            InputError: there are several; `what` says who needs one, as in "steady rows are".
        """
        found = [table for table in self.tables if len(table) > 1] or [*self.tables]
        if len(found) != 1:
            names = ", ".join(table.name or f"one of {len(table)} rows" for table in found)
            raise InputError(f"{self.path}: has the tables {names}; {what} possible with one alone")
        return found[0]

    def extent(self) -> str:
        """File and rows in words."""
        filled = [table for table in self.tables if len(table)]
        if len(self.tables) == 1 and filled:
            (table,) = filled
            first, last = table.lines[0], table.lines[-1]
            return f"{table.place(0)}" if first == last else _range(table)
        return str(self.path)

    def _all(self, column: ColumnName) -> Iterator[tuple[Table, str]]:
        """Tables and headings that a name may mean."""
        for table in self.tables:
            heading = self.heading_in(table, column)
            if heading is not None:
                yield table, heading

    def _nearest(self, column: ColumnName) -> str:
        """Hint on the columns that there are."""
        if isinstance(column, int):
            if len(self.tables) > 1:
                return "columns have numbers where there is one table; write its heading"
            return f"the columns have the numbers 1 to {sum(len(t.headings) for t in self.tables)}"
        if len(self.tables) == 1:
            return nearest(column, self.tables[0].headings)
        return nearest(column, [f"{t.name}.{each}" for t in self.tables for each in t.headings])


def _range(table: Table) -> str:
    """File and first to last row of a table."""
    name = f", {table.name}" if table.name else ""
    return f"{table.path}{name}, {table.row_word}s {table.lines[0]}-{table.lines[-1]}"
