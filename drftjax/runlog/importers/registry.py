"""Importers by the suffix of a file; installed packages add theirs.

A package adds a format by the entry-point group `drft.importers`: the suffix without its dot, and
the function, a `drftjax.runlog.importers.base.Importer`.
"""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final, cast

from drftjax.common.errors import InputError
from drftjax.runlog.importers.base import Importer
from drftjax.runlog.importers.table import import_named_runs

GROUP: Final = "drft.importers"

IMPORTERS: Final[Mapping[str, Importer]] = {
    ".csv": import_named_runs,
    ".tsv": import_named_runs,
    ".txt": import_named_runs,
}


def suffixes() -> list[str]:
    """Suffixes of all files that can be imported, this project's first."""
    return [*IMPORTERS, *(suffix for suffix in _added() if suffix not in IMPORTERS)]


def importer_for(path: Path) -> Importer:
    """Importer of a file by its suffix, a final .gz aside; a table's for an unknown suffix.

    Raises:
        InputError: a package's importer fails to load, or two packages claim the suffix.
    """
    suffix = Path(path.name.lower().removesuffix(".gz")).suffix
    added = _added().get(suffix, [])
    if len(added) + (suffix in IMPORTERS) > 1:
        others = " and ".join(each.value for each in added)
        here = "drftjax and " if suffix in IMPORTERS else ""
        raise InputError(f"files {suffix} are claimed by {here}{others}; remove one")
    if not added:
        return IMPORTERS.get(suffix, import_named_runs)
    entry = added[0]
    try:
        importer = entry.load()
    except Exception as error:
        raise InputError(f"the importer {suffix} of {entry.value} fails: {error}") from None
    if not callable(importer):
        raise InputError(f"the importer {suffix} of {entry.value} is no function")
    return cast(Importer, importer)


def _added() -> dict[str, list[EntryPoint]]:
    """Entry points of installed packages by suffix."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=GROUP):
        found.setdefault(f".{entry.name.lower().lstrip('.')}", []).append(entry)
    return found
