"""Sheets of a workbook (.xlsx), read by openpyxl."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from drftjax.common.errors import InputError
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.packages import required_package, unreadable
from drftjax.runlog.importers.readers.rows import Row, table_of_rows
from drftjax.runlog.importers.table import ISO, Table
from drftjax.runlog.validation import nearest


def sheet_rows(path: Path, layout: Layout) -> list[list[str]]:
    """All rows of a sheet as text, by the sheet and decimal sign of a layout.

    Raises:
        InputError: as for `read_workbook`.
    """
    return [cells for _, cells in _rows(path, replace(layout, skip_lines=0), set())]


def read_workbook(path: Path, layout: Layout) -> list[Table]:
    """Read one sheet of a workbook, with the values that formulas had when it was saved.

    Args:
        path: The workbook.
        layout: Sheet, and the place of its rows; numbers have no decimal sign there.

    Raises:
        InputError: names the file, the sheet or the row, and what must hold.
    """
    dated: set[int] = set()
    table = table_of_rows(path, _rows(path, layout, dated), layout, row_word="row")
    stamps = {name: ISO for at, name in enumerate(table.headings) if at in dated}
    return [replace(table, units=stamps)]


def _values(path: Path, layout: Layout) -> list[tuple[Any, ...]]:
    """Values of all rows of a sheet."""
    openpyxl = required_package("openpyxl", "openpyxl", path)
    try:
        # Sheets are unpacked while they are read, so damage is found as late as that.
        with closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
            names = [sheet.title for sheet in book.worksheets]
            wanted = layout.sheet or next(iter(names), None)
            if wanted in names:
                return list(book[wanted].iter_rows(values_only=True))
    except Exception as error:
        raise unreadable(path, "a workbook", error) from None
    if layout.sheet is None:
        raise InputError(f"{path}: has no sheet with cells")
    raise InputError(f"{path}: there is no sheet {layout.sheet!r}; {nearest(layout.sheet, names)}")


def _rows(path: Path, layout: Layout, dated: set[int]) -> Iterator[Row]:
    """Rows below the skipped ones, as text; columns with dates are added to `dated`."""
    for number, row in enumerate(_values(path, layout), 1):
        if number > layout.skip_lines:
            dated.update(at for at, cell in enumerate(row) if isinstance(cell, datetime | time))
            yield number, [_text(cell, layout.decimal) for cell in row]


def _text(cell: Any, decimal: str) -> str:
    """Cell as text; a date in ISO 8601, a span of time in seconds."""
    if cell is None:
        return ""
    if isinstance(cell, datetime | date | time):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        cell = cell.total_seconds()
    if isinstance(cell, float):
        return repr(cell).replace(".", decimal)
    return str(cell)
