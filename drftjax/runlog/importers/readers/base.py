"""Interface of the readers: a file in, its tables out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.table import Table


class Reader(Protocol):
    """Reads the tables of one file, whose columns a mapping then gives their meaning."""

    def __call__(self, path: Path, layout: Layout, /) -> Sequence[Table]:
        """Read the tables of a file.

        Args:
            path: The file.
            layout: Place of the headings and rows; a format that says so itself ignores it.

        Returns:
            Tables of one row count each; columns with equal times stand in one table.

        Raises:
            InputError: the file cannot be read; names it, and what must hold.
        """
        ...
