"""Tables and sentences as text for a terminal and as HTML for a notebook."""

from collections.abc import Sequence
from io import StringIO

from rich.console import Console
from rich.table import Table

from drftjax.common.text import replace_unprintable

HTML_WIDTH = 160
"""Width of HTML in characters: no cell of a usual table is folded, and notebooks scroll."""

FRAME = '<pre style="line-height: normal; overflow-x: auto">{code}</pre>'


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
