"""Interface of the importers: files of other programs in, run logs out."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drftjax.runlog.record import RunLog


@dataclass(frozen=True)
class ImportedRun:
    """A run, and the name of the file that it is written to.

    Attributes:
        name: Any text; it is made a safe file name.
        run: Run log.
        losses: Sentences on samples of the file that the run does not keep.
    """

    name: str
    run: RunLog
    losses: tuple[str, ...] = ()


class Importer(Protocol):
    """Reads the runs of one file."""

    def __call__(self, path: Path, mapping: Path | None, /) -> Iterable[ImportedRun]:
        """Read the runs of a file.

        Args:
            path: The file.
            mapping: TOML file that says what the file's columns mean; None where none was given.

        Raises:
            InputError: the file cannot be read so, or the format needs a mapping.
        """
        ...
