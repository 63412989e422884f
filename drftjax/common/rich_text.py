"""Tables and sentences as text for a terminal and as HTML for a notebook."""

from collections.abc import Sequence
from io import StringIO
from typing import NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from drftjax.common.text import replace_unprintable

HTML_WIDTH = 160
"""Width of HTML in characters: no cell of a usual table is folded, and notebooks scroll."""

FRAME = '<pre style="line-height: normal; overflow-x: auto">{code}</pre>'


class TableCells(NamedTuple):
    """Plain texts of a table.

    Attributes:
        title: Empty for none.
        head: Of each column.
        rows: From top to bottom.
    """

    title: str
    head: list[str]
    rows: list[list[str]]


def table_cells(table: Table) -> TableCells:
    """Texts of a table's cells without their markup, for a page."""
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    head = [_plain(column.header) for column in table.columns]
    return TableCells(
        _plain(table.title or ""), head, [list(row) for row in zip(*columns, strict=True)]
    )


def _plain(cell: object) -> str:
    return replace_unprintable(
        cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain
    )


def summary_text(parts: Sequence[Table | str], width: int) -> str:
    """Render tables and sentences as plain text of this width in characters."""
    console = Console(file=StringIO(), width=width, color_system=None, force_jupyter=False)
    return _recorded(console, parts).export_text()


def summary_html(parts: Sequence[Table | str]) -> str:
    """Render tables and sentences as HTML that needs no style sheet."""
    console = Console(file=StringIO(), width=HTML_WIDTH, force_jupyter=False)
    return _recorded(console, parts).export_html(inline_styles=True, code_format=FRAME)


def _recorded(console: Console, parts: Sequence[Table | str]) -> Console:
    """Print the parts on a console that records them for export."""
    console.record = True
    for part in parts:
        if isinstance(part, Table):
            console.print(part)
        else:
            # File names may hold brackets, which are no markup.
            console.print(replace_unprintable(part), markup=False, highlight=False)
    return console
