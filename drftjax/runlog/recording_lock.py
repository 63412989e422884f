"""Whether a recording is at work on a file, or was cut off and left.

The recorder holds a POSIX lock on the file, which the system lets go when the recorder ends in
whatever way. HDF5's own locks are of another kind (flock) and are not touched by it.
"""

import fcntl
import os
from contextlib import suppress
from pathlib import Path

PART: str = ".part"
"""What stands behind a run log's name while it is recorded."""


def part_path(path: Path) -> Path:
    """Where a run log stands while it is recorded."""
    return path.with_name(path.name + PART)


def hold(handle: int) -> None:
    """Take the lock through a file descriptor that is open for writing, for as long as it is open.

    The lock is also let go when this process closes any other descriptor of the same file.
    """
    with suppress(OSError):  # some network drives have no locks
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_held(path: Path) -> bool:
    """Whether another process records into the file now."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.lockf(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False
