"""Tables of an experimenter: columns of equal length, with the place of each row in the file."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.validation import nearest

Reals = NDArray[np.float64]

Cells = Sequence[str] | NDArray[Any]
"""Cells of a column: text, or an array of numbers in which NaN is a gap."""

ROW_LIMIT: Final = 5_000_000
"""Most rows of a table."""

ISO: Final = "iso8601"
"""Unit of stamps such as 2026-03-01T10:00:00.125Z, or of times of day."""

GAPS: Final = frozenset({"", "-", "--", "na", "n/a", "nan", "#n/a", "null", "none"})
"""Cells, in small letters, that say that nothing was measured."""

_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")

_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d|\d\d?:\d\d:\d\d|\d\d?[./]\d\d?[./]\d{4}")


@dataclass(frozen=True)
class Table:
    """Columns of equal length.

    Attributes:
        path: File that holds the table.
        headings: Names of the columns, each once.
        columns: Cells of each column.
        lines: Number of each row, as the file's program counts: from 1, headings included.
        name: Name among the tables of the file, such as a topic's; "" for the only one.
        row_word: Word for a row: "line" of a text, "row" of a sheet, "message" of a topic.
        units: Unit of a column, where the file itself states it.
        decimal: Decimal sign of cells that are text.
    """

    path: Path
    headings: tuple[str, ...]
    columns: tuple[Cells, ...]
    lines: Sequence[int]
    name: str = ""
    row_word: str = "line"
    units: Mapping[str, str] = field(default_factory=dict)
    decimal: str = "."

    def __len__(self) -> int:
        return len(self.lines)

    def column(self, heading: str) -> Cells:
        """Cells of a column.

        Raises:
            InputError: there is no such heading; names the nearest ones.
        """
        if heading not in self.headings:
            raise InputError(
                f"{self.path}: there is no column {heading!r}; {nearest(heading, self.headings)}"
            )
        return self.columns[self.headings.index(heading)]

    def cells(self, heading: str) -> list[str]:
        """Cells of a column as text; numbers in their shortest form."""
        return [each if isinstance(each, str) else _text(each) for each in self.column(heading)]

    def numbers(self, heading: str) -> Reals:
        """Cells of a column as numbers, NaN where there is a gap, shape (rows,).

        Raises:
            InputError: names the place of the first cell that is neither, and the likely cause.
        """
        cells = self.column(heading)
        if isinstance(cells, np.ndarray) and cells.dtype.kind in "biuf":
            values = cells.astype(np.float64)
            bad = np.flatnonzero(np.isinf(values))
        else:
            values = np.array([number(str(cell), self.decimal) for cell in cells], dtype=np.float64)
            gaps = np.array([str(cell).strip().lower() in GAPS for cell in cells], dtype=bool)
            bad = np.flatnonzero(~np.isfinite(values) & ~gaps)
        if bad.size:
            raise InputError(self.explain(int(bad[0]), heading))
        return values

    def place(self, row: int) -> str:
        """Place of a row in words: the file, and the line, row or message in it."""
        where = f", {self.name}" if self.name else ""
        return f"{self.path}{where}, {self.row_word} {self.lines[row]}"

    def explain(self, row: int, heading: str, must: str = "be a finite number") -> str:
        """Sentence on a cell that cannot be used, with its likely cause.

        Args:
            row: Its row in this table.
            heading: Its column.
            must: Rule that it breaks.
        """
        cell = self.cells(heading)[row].strip()
        hint = self._cause(row, cell)
        return f"{self.place(row)}: {heading} is {cell!r}, it must {must}{hint and '; ' + hint}"

    def _cause(self, row: int, cell: str) -> str:
        """Likely cause of a text among numbers, with the remedy; "" where there is none."""
        if self.decimal == "." and _DECIMAL_COMMA.fullmatch(cell):
            return 'for a decimal comma write decimal = "," in the mapping; --guess proposes one'
        if _DATE.search(cell):
            return 'for a date or a time of day write unit = "iso8601", or a pattern with %'
        if row == 0 and units.is_unit(cell):
            return (
                "for a line of units below the headings write skip_below = 1 in the mapping; "
                "--guess proposes one"
            )
        first = next((each for each in (str(column[row]) for column in self.columns) if each), "")
        if row > 0 and number(first, self.decimal) != number(first, self.decimal):
            start = first.strip().replace("\\", "\\\\").replace('"', '\\"')
            return f'if the table ends there, write end_at = "{start}" in the mapping'
        return ""

    def select_rows(self, rows: "Sequence[int] | NDArray[np.intp]") -> "Table":
        """Table of some of the rows, in the given order."""
        taken = [
            each[rows] if isinstance(each, np.ndarray) else [each[row] for row in rows]
            for each in self.columns
        ]
        return replace(self, columns=tuple(taken), lines=[self.lines[row] for row in rows])


def named_tables(
    path: Path, tables: Mapping[str, Mapping[str, Cells]], row_word: str, **fixed: Any
) -> list[Table]:
    """Tables of a file without lines, whose rows are counted from 1.

    Args:
        path: The file.
        tables: Cells by heading, by name of the table.
        row_word: Word for a row.
        **fixed: Other fields of every `Table`.
    """
    made = []
    for name, columns in tables.items():
        rows = len(next(iter(columns.values()), ()))
        if rows > ROW_LIMIT:
            raise InputError(f"{path}: {name} has more than {ROW_LIMIT} rows; split it")
        cells = tuple(columns.values())
        made.append(Table(path, tuple(columns), cells, range(1, rows + 1), name, row_word, **fixed))
    return made


def number(cell: str, decimal: str = ".") -> float:
    """Cell as a number; NaN where it is none."""
    if decimal == ",":
        # 1.165 would be a thousand and more to the one, a fraction to the other.
        cell = "" if "." in cell else cell.replace(",", ".")
    try:
        # Python would read 1_7 as 17.
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _text(value: object) -> str:
    """Number as text, whole ones without a point."""
    if isinstance(value, float | np.floating):
        return "" if math.isnan(value) else f"{value:.15g}"
    return str(value)
