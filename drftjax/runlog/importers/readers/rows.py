"""Tables from rows of cells, as a text or a sheet has them."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.table import ROW_LIMIT, Table

Row = tuple[int, list[str]]
"""Number of a row in the file, and its cells."""


def table_of_rows(
    path: Path, rows: Iterable[Row], layout: Layout, name: str = "", row_word: str = "line"
) -> Table:
    """Table of rows, all of which must have a cell for each heading.

    Args:
        path: File that holds them.
        rows: All rows below the skipped lines.
        layout: Place of the headings and of the end.
        name, row_word: As in `Table`.

    Raises:
        InputError: names the row and what must hold.
    """
    left = iter(rows)
    headings: tuple[str, ...] = ()
    if layout.headings:
        number, cells = next(left, (layout.skip_lines + 1, []))
        headings = _headings(path, f"{row_word} {number}", cells, layout)
    for _ in range(layout.skip_below):
        next(left, None)
    kept: list[list[str]] = []
    numbers: list[int] = []
    for number, cells in _until_end(left, layout.end_at):
        if not headings:
            headings = tuple(str(position + 1) for position in range(len(cells)))
        row = cells
        # Some programs end every row with a separator, and a sheet has empty cells on the right.
        if len(row) > len(headings) and not any(map(str.strip, row[len(headings) :])):
            row = row[: len(headings)]
        if len(row) != len(headings):
            raise InputError(f"{path}, {row_word} {number}: {_wrong_width(row, headings, layout)}")
        if len(kept) == ROW_LIMIT:
            raise InputError(f"{path}: has more than {ROW_LIMIT} rows; split it")
        kept.append(row)
        numbers.append(number)
    columns = tuple(map(list, zip(*kept, strict=True))) or tuple([] for _ in headings)
    return Table(path, headings, columns, numbers, name, row_word, decimal=layout.decimal)


def _until_end(rows: Iterator[Row], end: str | None) -> Iterator[Row]:
    """Rows that are not empty, up to the one that begins with the given text."""
    for number, cells in rows:
        empty = not any(map(str.strip, cells))
        if end is not None and (empty if not end else cells and cells[0].strip().startswith(end)):
            return
        if not empty:
            yield number, cells


def _headings(path: Path, place: str, cells: list[str], layout: Layout) -> tuple[str, ...]:
    """Headings of a table, each once; empty ones at the end are from cells that hold nothing."""
    while len(cells) > 1 and not cells[-1].strip():
        cells = cells[:-1]
    if not any(map(str.strip, cells)):
        raise InputError(f"{path}: {place} must hold the headings, but it is empty")
    # Sheets have headings of several lines.
    lines = (" ".join(filter(None, map(str.strip, cell.splitlines()))) for cell in cells)
    headings = tuple(name or str(at + 1) for at, name in enumerate(lines))
    twice = next((name for name in headings if headings.count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f"{path}: the heading {twice!r} stands over two columns; for columns by number write "
            f"headings = false and skip_lines = {layout.skip_lines + 1} in the mapping"
        )
    return headings


def _wrong_width(row: list[str], headings: tuple[str, ...], layout: Layout) -> str:
    """Sentence on a row that has not a cell for each heading, with its likely cause."""
    what = f"has {len(row)} cells under {len(headings)} headings"
    if layout.separator == "," and len(row) == 2 * len(headings):
        return f"{what}; if these are decimal commas, the cells must be parted by another sign"
    if len(row) < len(headings) and len(row) <= 2:
        start = json.dumps(row[0].strip(), ensure_ascii=False)
        return f"{what}; if the table ends there, write end_at = {start} in the mapping"
    return what
