"""Readers by the suffix of a file; installed packages add theirs.

A package adds a format by the entry-point group `drft.readers`: the suffix without its dot, and the
function, a `drftjax.runlog.importers.readers.base.Reader`. The mapping gives its columns their
meaning, as for a table of text.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final, cast

from drftjax.common.errors import InputError, missing_path
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.base import Reader
from drftjax.runlog.importers.readers.packages import silenced
from drftjax.runlog.importers.table import Table

GROUP: Final = "drft.readers"

READERS: Final[Mapping[str, str]] = {
    ".csv": "delimited:read_delimited",
    ".tsv": "delimited:read_delimited",
    ".txt": "delimited:read_delimited",
    ".dat": "delimited:read_delimited",
    ".xlsx": "workbook:read_workbook",
    ".xlsm": "workbook:read_workbook",
    ".mat": "matlab:read_mat",
    ".parquet": "parquet:read_parquet",
    ".tdms": "tdms:read_tdms",
    ".mcap": "mcap_file:read_mcap",
    ".bag": "ros_bag:read_ros_bag",
    ".db3": "ros_bag:read_ros_bag",
}
"""Modules and functions in this folder; a module is imported when its suffix is read."""

WITH_LAYOUT: Final = frozenset({"delimited", "workbook"})
"""Modules of formats whose rows can lie anywhere in the file."""


def reader_suffixes() -> list[str]:
    """Suffixes of all files that can be read as tables, this project's first."""
    return [*READERS, *(each for each in added_by_suffix(GROUP) if each not in READERS)]


def read_tables_of(path: Path, layout: Layout) -> Sequence[Table]:
    """Read the tables of a file, by its suffix; an unknown one is read as text.

    Raises:
        InputError: the file cannot be read, or the layout is for tables of text alone.
    """
    if not path.exists():
        raise InputError(f"{path}: {missing_path(path)}")
    module, reader = reader_for(path)
    keys = layout.set_keys()
    if keys and module not in (None, *WITH_LAYOUT):
        raise InputError(
            f"{path}: {', '.join(keys)} in the mapping is for text and workbooks; leave it out "
            "for this file"
        )
    with silenced():
        return reader(path, layout)


def reader_for(path: Path) -> tuple[str | None, Reader]:
    """Reader of a file by its suffix, a final .gz aside, and its module here if it has one.

    Raises:
        InputError: a package's reader fails to load, or two packages claim the suffix.
    """
    suffix = suffix_of(path)
    if path.is_dir():
        suffix = ".db3"  # a ROS 2 bag is a folder
    added = added_by_suffix(GROUP).get(suffix, [])
    entry = sole_entry(suffix, added, suffix in READERS)
    if entry is not None:
        return None, cast(Reader, load_function(entry, f"the reader {suffix}"))
    module, name = READERS.get(suffix, READERS[".csv"]).split(":")
    package = __name__.rpartition(".")[0]
    return module, getattr(import_module(f"{package}.{module}"), name)


def suffix_of(path: Path) -> str:
    """Suffix of a file in small letters, a final .gz aside."""
    return Path(path.name.lower().removesuffix(".gz")).suffix


def added_by_suffix(group: str) -> dict[str, list[EntryPoint]]:
    """Entry points of installed packages by suffix."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=group):
        found.setdefault(f".{entry.name.lower().lstrip('.')}", []).append(entry)
    return found


def sole_entry(suffix: str, added: Sequence[EntryPoint], ours: bool) -> EntryPoint | None:
    """Entry point for a suffix; None where it is ours.

    Raises:
        InputError: two packages claim it.
    """
    if len(added) + ours > 1:
        others = " and ".join(each.value for each in added)
        here = "drftjax and " if ours else ""
        raise InputError(f"files {suffix} are claimed by {here}{others}; remove one")
    return added[0] if added else None


def load_function(entry: EntryPoint, label: str) -> object:
    """Function of an entry point.

    Raises:
        InputError: it cannot be loaded, or is no function.
    """
    try:
        loaded = entry.load()
    except Exception as error:
        raise InputError(f"{label} of {entry.value} fails: {error}") from None
    if not callable(loaded):
        raise InputError(f"{label} of {entry.value} is no function")
    return loaded
