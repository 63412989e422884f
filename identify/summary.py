"""A table and sentences under it, as text for a terminal and as HTML for a notebook."""

from collections.abc import Sequence
from io import StringIO

from rich.console import Console
from rich.table import Table

from drftjax.runlog.content import printable

# Wide enough that no cell of a usual table is folded; notebooks scroll.
HTML_WIDTH = 160
FRAME = '<pre style="line-height: normal; overflow-x: auto">{code}</pre>'


def summary_text(table: Table, sentences: Sequence[str], width: int) -> str:
    """Both as plain text."""
    console = Console(file=StringIO(), width=width, color_system=None)
    return _recorded(console, table, sentences).export_text()


def summary_html(table: Table, sentences: Sequence[str]) -> str:
    """Both as HTML that needs no style sheet."""
    console = Console(file=StringIO(), width=HTML_WIDTH)
    return _recorded(console, table, sentences).export_html(inline_styles=True, code_format=FRAME)


def _recorded(console: Console, table: Table, sentences: Sequence[str]) -> Console:
    console.record = True
    console.print(table)
    for sentence in sentences:
        # File names may hold brackets, which are no markup.
        console.print(printable(sentence), markup=False, highlight=False)
    return console
