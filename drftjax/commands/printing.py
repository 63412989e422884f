"""Sentences of commands: broken between words in a terminal, in one line elsewhere.

A line that goes to a file or another program is one sentence, whatever the width. A name that is
wider than the terminal is not broken, so that it can be copied.
"""

import shlex
import shutil
import sys
from textwrap import fill
from typing import TYPE_CHECKING

from drftjax.common.text import replace_unprintable

if TYPE_CHECKING:
    from rich.console import Console


def say(text: str, *, error: bool = False) -> None:
    """Print lines of text.

    Args:
        text: Sentences, with line breaks between them.
        error: True to print to standard error.
    """
    stream = sys.stderr if error else sys.stdout
    width = shutil.get_terminal_size().columns if stream.isatty() else None
    print("\n".join(_folded(line, width) for line in text.split("\n")), file=stream, flush=True)


def say_next(*words: object) -> None:
    """Print the command that usually follows, in one line, so that it can be copied.

    Args:
        words: Those after `drft`. A word in capitals, such as OTHER_RUNS, is for the user to fill.
    """
    print(f"next: drft {shlex.join(map(str, words))}", flush=True)


def say_on(console: "Console", text: str, style: str | None = None) -> None:
    """Print a sentence beside the tables and the progress of a console.

    Args:
        console: The console.
        text: Plain text: brackets are no markup, and control characters are replaced.
        style: Of `rich`, such as "yellow".
    """
    line = _folded(replace_unprintable(text), console.width if console.is_terminal else None)
    # Rich itself would break a long name.
    console.print(line, style=style, markup=False, highlight=False, soft_wrap=True)


def _folded(line: str, width: int | None) -> str:
    """A line broken between words at the width of a terminal; None leaves it whole."""
    if width is None or len(line) <= width:
        return line
    indent = " " * (len(line) - len(line.lstrip(" ")))
    return fill(
        line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
