"""Where a recording can be begun, and go on."""

import os
from pathlib import Path
from typing import Final

from drftjax.errors import InputError

RESERVE: Final = 2**21
"""Room that is never used, for HDF5's own bookkeeping [bytes]."""


def require_place(path: Path) -> None:
    """Refuse a folder that a recording cannot be begun in.

    Raises:
        InputError: It is not there, may not be written, or has no room.
    """
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"the folder {path.parent} may not be written")
    require_room(path.parent, RESERVE)


def require_room(place: Path | int, wanted: int) -> None:
    """Refuse a disk with less room than so many bytes; by a name, or an open file.

    Raises:
        InputError: how much is left.
    """
    facts = os.statvfs(place)
    free = facts.f_bavail * facts.f_frsize
    if free < wanted:
        raise InputError(f"the disk is full: {free / 2**20:.1f} MiB are left")
