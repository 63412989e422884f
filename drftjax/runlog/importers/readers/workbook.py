"""Sheets of a workbook (.xlsx), read by openpyxl."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
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
    with _sheet(path, layout) as sheet:
        return [cells for _, cells in _rows(sheet, replace(layout, skip_lines=0), set())]


def read_workbook(path: Path, layout: Layout) -> list[Table]:
    """Read one sheet of a workbook, with the values that formulas had when it was saved.

    Args:
        path: The workbook.
        layout: Sheet, and the place of its rows; numbers have no decimal sign there.

    Raises:
        InputError: names the file, the sheet or the row, and what must hold.
    """
    with _sheet(path, layout) as sheet:
        dated: set[int] = set()
        table = table_of_rows(path, _rows(sheet, layout, dated), layout, row_word="row")
    stamps = {name: ISO for at, name in enumerate(table.headings) if at in dated}
    return [replace(table, units=stamps)]


@contextmanager
def _sheet(path: Path, layout: Layout) -> Iterator[Any]:
    """Open sheet of a workbook."""
    openpyxl = required_package("openpyxl", "openpyxl", path)
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    except Exception as error:
        raise unreadable(path, "a workbook", error) from None
    with closing(book):
        names = [sheet.title for sheet in book.worksheets]
        if layout.sheet is not None and layout.sheet not in names:
            raise InputError(
                f"{path}: there is no sheet {layout.sheet!r}; {nearest(layout.sheet, names)}"
            )
        if not names:
            raise InputError(f"{path}: has no sheet with cells")
        yield book[layout.sheet or names[0]]


def _rows(sheet: Any, layout: Layout, dated: set[int]) -> Iterator[Row]:
    """Rows below the skipped ones, as text; columns with dates are added to `dated`."""
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
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
