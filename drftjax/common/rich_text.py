"""Tables and sentences as text for a terminal and as HTML for a notebook."""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from io import StringIO
from typing import NamedTuple, cast

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Column, Table
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


@dataclass(frozen=True)
class _Widths:
    """Widths of a column's content [characters]: of its longest word, and of its longest line."""

    word: int
    line: int


class WholeWordTable(Table):
    """Table that breaks no word and shortens no name, whatever the width.

    Columns give way down to their longest word; those that still do not fit stand in further tables
    below, each with the first column. A word that is wider than the page is the one exception.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table, or the parts of it one below the other."""
        widths = [_widths(each) for each in self.columns]
        if sum(each.line for each in widths) <= self._space(options.max_width, len(widths)):
            yield from Table.__rich_console__(self, console, options)
            return
        for chosen in self._groups(widths, options.max_width):
            space = self._space(options.max_width, len(chosen))
            contents = _shared_out([widths[each] for each in chosen], space)
            part = self._part(chosen, contents)
            yield from Table.__rich_console__(part, console, options)

    def _space(self, width: int, columns: int) -> int:
        """Width that borders and padding leave for the content of so many columns."""
        _, right, _, left = self.padding
        borders = 0 if self.box is None else columns - 1 + 2 * self.show_edge
        return width - columns * (left + right) - borders

    def _groups(self, widths: Sequence[_Widths], width: int) -> Iterator[list[int]]:
        """Columns of each part: as many as have place for their longest words."""
        chosen = [0]
        for each in range(1, len(widths)):
            words = sum(widths[other].word for other in (*chosen, each))
            if len(chosen) > 1 and words > self._space(width, len(chosen) + 1):
                yield chosen
                chosen = [0]
            chosen.append(each)
        yield chosen

    def _part(self, chosen: Sequence[int], contents: Sequence[int]) -> "WholeWordTable":
        """The table of some of the columns, with the widths of their contents."""
        part = copy(self)
        part.columns, part.rows = [], []
        part.title = self.title if 1 in chosen or len(self.columns) == 1 else None
        old = [self.columns[each] for each in chosen]
        for column, width in zip(old, contents, strict=True):
            part.add_column(column.header, justify=column.justify, overflow="fold", width=width)
        for row, *cells in zip(self.rows, *(column.cells for column in old), strict=True):
            part.add_row(*cells, style=row.style, end_section=row.end_section)
        return part


def _widths(column: Column) -> _Widths:
    texts = (
        Text.from_markup(each) if isinstance(each, str) else each
        for each in (column.header, *column.cells)
    )
    lines = [line for text in texts for line in cast(Text, text).plain.split("\n")]
    # The blanks that a line begins with stay before its first word.
    indents = [len(line) - len(line.lstrip(" ")) for line in lines]
    words = [max(map(cell_len, line.split()), default=0) for line in lines]
    longest = max(map(sum, zip(indents, words, strict=True)))
    return _Widths(longest, max(map(cell_len, lines)))


def _shared_out(columns: Sequence[_Widths], space: int) -> list[int]:
    """Width of each column: its longest line, or less, the widest columns giving way first."""
    widths = [each.line for each in columns]
    while sum(widths) > space:
        can = [at for at, each in enumerate(columns) if widths[at] > each.word]
        # Where the words alone are too wide, the widest is broken.
        widest = max(can or range(len(widths)), key=widths.__getitem__)
        if widths[widest] == 1:
            break
        widths[widest] -= 1
    return widths


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
