"""Layout of a table of text or a sheet, found out from its first and last rows."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError
from drftjax.runlog.importers import units
from drftjax.runlog.importers.layout import DEFAULT_LAYOUT, Layout
from drftjax.runlog.importers.readers.delimited import SEPARATORS, read_text, with_separator
from drftjax.runlog.importers.readers.registry import reader_for
from drftjax.runlog.importers.readers.workbook import sheet_rows
from drftjax.runlog.importers.table import GAPS, number

_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d|\d\d?:\d\d(:\d\d)?|\d\d?\.\d\d?\.\d{4}")

Cells = list[list[str]]


@dataclass(frozen=True)
class LayoutSettings:
    """Rows that are looked at.

    Attributes:
        first_rows: Rows from the top; headings stand within a few dozen lines.
        last_rows: Rows from the end; a footer is a few lines.
        number_share: Least share of a row's filled cells that are numbers or times, of a row of
            data: one of a stamp and one of a number.
        filled_share: Least count of headings, over the filled cells of a row of data.
        unit_share: Least share of a row's filled cells that are units, of a row of units.
    """

    first_rows: int = 500
    last_rows: int = 50
    number_share: float = 0.5
    filled_share: float = 0.7
    unit_share: float = 0.5


DEFAULT_ROWS: Final = LayoutSettings()


@dataclass(frozen=True)
class GuessedLayout:
    """Layout, and what the rows between headings and data say.

    Attributes:
        layout: Signs and places.
        units: Cells of the row of units; none where there is no such row.
        doubts: Sentences on what is unsure.
    """

    layout: Layout
    units: tuple[str, ...] = ()
    doubts: tuple[str, ...] = field(default=())


def guess_layout(path: Path, settings: LayoutSettings = DEFAULT_ROWS) -> GuessedLayout:
    """Find out the layout of a file, by its suffix; of other formats than text, the default.

    Args:
        path: The file.
        settings: Rows that are looked at.

    Raises:
        InputError: the file cannot be read, or no row of numbers is found in it.
    """
    module, _ = reader_for(path)
    if module == "workbook":
        rows = sheet_rows(path, DEFAULT_LAYOUT)
        return _placed(path, rows, DEFAULT_LAYOUT, settings)
    if module != "delimited":
        return GuessedLayout(DEFAULT_LAYOUT)
    encoding = None
    try:
        text = read_text(path)
    except InputError as error:
        if "UTF-8" not in str(error):
            raise
        encoding, text = "cp1252", read_text(path, "cp1252")
    lines = text.splitlines()
    if len(lines) > settings.first_rows + settings.last_rows:
        # The end alone is needed of the rest; line numbers below the headings do not matter.
        lines = lines[: settings.first_rows] + lines[-settings.last_rows :]
    signs = [(each, sign) for each in SEPARATORS for sign in ".," if each != sign]
    separator, decimal = max(signs, key=lambda pair: _numbers_in(lines, *pair))
    layout = Layout(separator=separator, decimal=decimal, encoding=encoding)
    found = _placed(path, _split(lines, separator), layout, settings)
    bare = replace(found.layout, separator=None)
    if with_separator(path, text, bare).separator == separator:
        found = replace(found, layout=bare)  # the import finds it, too
    doubts = ("the text is no UTF-8; it is taken for that of Windows (cp1252)",) * bool(encoding)
    return replace(found, doubts=(*doubts, *found.doubts))


def _split(lines: Sequence[str], separator: str) -> Cells:
    """Rows of cells."""
    try:
        return list(csv.reader(lines, delimiter=separator))
    except csv.Error:
        return []


def _numbers_in(lines: Sequence[str], separator: str, decimal: str) -> int:
    """Number of cells that are numbers, in rows of the usual count of cells, two at least."""
    rows = [row for row in _split(lines, separator) if len(row) > 1]
    if not rows:
        return 0
    usual = Counter(map(len, rows)).most_common(1)[0][0]
    return sum(_is_number(cell, decimal) for row in rows if len(row) == usual for cell in row)


def _is_number(cell: str, decimal: str) -> bool:
    """True of a number."""
    value = number(cell.strip(), decimal)
    return value == value


def _is_data(row: Sequence[str], decimal: str, settings: LayoutSettings) -> bool:
    """True of a row of numbers, with times and gaps among them."""
    cells = [cell.strip() for cell in row if cell.strip()]
    numbers = sum(_is_number(cell, decimal) for cell in cells)
    fits = sum(bool(_DATE.search(cell)) or cell.lower() in GAPS for cell in cells)
    return numbers > 0 and numbers + fits >= settings.number_share * len(cells)


def _placed(path: Path, rows: Cells, layout: Layout, settings: LayoutSettings) -> GuessedLayout:
    """Layout with the places of headings, units and end."""
    data = [_is_data(row, layout.decimal, settings) for row in rows]
    pairs = (at for at in range(len(rows)) if data[at] and all(data[at + 1 : at + 2]))
    first = next(pairs, None)
    if first is None:
        raise InputError(f"{path}: no row of numbers is found; is this a table?")
    width = _filled(rows[first])
    named = [
        at
        for at in range(first - 1, -1, -1)
        if _filled(rows[at]) >= settings.filled_share * width and not data[at]
    ]
    heading = next((at for at in named if _may_head(rows[at], settings)), None)
    if heading is None:
        layout = replace(layout, headings=False, skip_lines=first)
        doubt = "no headings are found; the columns are named by their numbers"
        return GuessedLayout(_ended(rows, data, layout), (), (doubt,))
    below = [at for at in named if at > heading and _is_units(rows[at], settings)]
    units_row = tuple(rows[below[0]]) if below else ()
    layout = replace(layout, skip_lines=heading, skip_below=first - heading - 1)
    return GuessedLayout(_ended(rows, data, layout), units_row)


def _filled(row: Sequence[str]) -> int:
    """Number of filled cells."""
    return sum(bool(cell.strip()) for cell in row)


def _is_units(row: Sequence[str], settings: LayoutSettings) -> bool:
    """True of a row of units."""
    cells = [cell for cell in row if cell.strip()]
    return sum(units.is_unit(cell) for cell in cells) >= settings.unit_share * len(cells) > 0


def _may_head(row: Sequence[str], settings: LayoutSettings) -> bool:
    """True of a row whose cells differ, and are no units."""
    cells = [cell.strip() for cell in row if cell.strip()]
    return len(set(cells)) == len(cells) and not _is_units(row, settings)


def _ended(rows: Cells, data: Sequence[bool], layout: Layout) -> Layout:
    """Layout with the end of the table, where something comes after it."""
    last = max(at for at, each in enumerate(data) if each)
    for row in islice(rows, last + 1, None):
        if _filled(row):
            blank = not _filled(rows[last + 1])
            return replace(layout, end_at="" if blank else row[0].strip())
    return layout
