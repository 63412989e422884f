"""Importers by the suffix of a file: the mapped import of tables, and those of installed packages.

A package adds a format whose runs need no mapping by the entry-point group `drft.importers`: the
suffix without its dot, and the function, a `drftjax.runlog.importers.base.Importer`. A format whose
columns a mapping explains is a reader (`drftjax.runlog.importers.readers.registry`).
"""

from pathlib import Path
from typing import Final, cast

from drftjax.runlog.importers.base import Importer
from drftjax.runlog.importers.mapped_runs import import_named_runs
from drftjax.runlog.importers.readers.registry import (
    READERS,
    added_by_suffix,
    load_function,
    reader_suffixes,
    sole_entry,
    suffix_of,
)

GROUP: Final = "drft.importers"


def suffixes() -> list[str]:
    """Suffixes of all files that can be imported, this project's first."""
    known = reader_suffixes()
    return [*known, *(each for each in added_by_suffix(GROUP) if each not in known)]


def importer_for(path: Path) -> Importer:
    """Importer of a file by its suffix, a final .gz aside; the mapped one where no package has it.

    Raises:
        InputError: a package's importer fails to load, or two packages claim the suffix.
    """
    suffix = suffix_of(path)
    entry = sole_entry(suffix, added_by_suffix(GROUP).get(suffix, []), suffix in READERS)
    if entry is None:
        return import_named_runs
    return cast(Importer, load_function(entry, f"the importer {suffix}"))
