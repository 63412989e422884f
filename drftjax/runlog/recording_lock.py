"""Lock of a recording, and free disk space before a recording.

The recorder holds a POSIX lock on its file, which the system releases when the recorder ends for
whatever reason: an unlocked recording is one that was interrupted. HDF5's own locks are of another
kind (flock) and do not interfere.
"""

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError

RESERVE: Final = 2**21
"""Room that is never used, for HDF5's own bookkeeping [bytes]."""


def require_place(path: Path) -> None:
    """Refuse a folder in which no recording can begin.

    Raises:
        InputError: it does not exist, is not writable, or its disk is full.
    """
    if not path.parent.is_dir():
        raise InputError(f"there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"the folder {path.parent} may not be written")
    require_room(path.parent, RESERVE)


def require_room(place: Path | int, wanted: int) -> None:
    """Refuse a disk with less free space than `wanted`.

    Args:
        place: Path or descriptor of a file or folder on the disk.
        wanted: Free space that is needed [bytes].

    Raises:
        InputError: names the free space.
    """
    facts = os.statvfs(place)
    free = facts.f_bavail * facts.f_frsize
    if free < wanted:
        raise InputError(f"the disk is full: {free / 2**20:.1f} MiB are left")


PART: str = ".part"
"""Suffix that is added to a run log's name while it is recorded."""


def part_path(path: Path) -> Path:
    """Path of a run log while it is recorded."""
    return path.with_name(path.name + PART)


def require_free(path: Path) -> None:
    """Refuse the name of a run log that exists, finished or as a recording.

    Raises:
        InputError: names the existing file.
    """
    part = part_path(path)
    if path.suffix != ".h5":
        raise InputError(f"{path}: a run log's name must end in .h5")
    if path.exists():
        raise InputError(f"{path} is already there; move it away or record under another name")
    # An empty one was left by a recorder that was killed before its first row.
    if part.exists() and (part.stat().st_size or is_held(part)):
        raise _taken(part)


def claim_file(path: Path) -> int:
    """Reserve the name of a run log for a recording, so that no other recorder can take it.

    Args:
        path: Final name.

    Returns:
        Descriptor of the file of the recording, which is empty and locked.

    Raises:
        InputError: the name is taken.
    """
    require_free(path)  # before the lock: it looks at the file through a descriptor of its own
    part = part_path(path)
    handle = os.open(part, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        hold_lock(handle, part)
        # Another recorder may have written into it, or given it up, before the lock was ours.
        if os.fstat(handle).st_size or not _is_file(handle, part):
            raise _taken(part)
    except BaseException:
        os.close(handle)
        raise
    return handle


def release_claim(handle: int, path: Path) -> None:
    """Release a reserved name, and remove its recording."""
    with suppress(InputError):
        place = place_of(handle, part_path(path))
        if place is not None:
            place.unlink(missing_ok=True)
    os.close(handle)


def hold_lock(handle: int, part: Path) -> None:
    """Lock a file through a descriptor that is open for writing, for as long as it is open.

    The lock is also released when this process closes any other descriptor of the same file.

    Raises:
        InputError: another process holds it.
    """
    import fcntl  # here, as not every system has it

    try:
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:  # some network drives have no locks
        if error.errno in (errno.EACCES, errno.EAGAIN):
            raise _taken(part) from None


def place_of(handle: int, part: Path) -> Path | None:
    """Present path of the file of a recording, whose folder may have been moved.

    Args:
        handle: Descriptor from `claim_file`.
        part: Path at which it was created.

    Returns:
        None where it was removed.

    Raises:
        InputError: it was moved, and the system does not report its new path.
    """
    if not os.fstat(handle).st_nlink:
        return None
    if _is_file(handle, part):
        return part
    with suppress(OSError):
        place = Path(f"/proc/self/fd/{handle}").readlink()
        if _is_file(handle, place):
            return place
    raise InputError(
        f"{part} was moved while it was recorded, nobody can tell where to; drft log repair mends "
        "it there"
    )


def is_held(path: Path) -> bool:
    """True while another process records into the file; False on a system without such locks."""
    try:
        import fcntl
    except ImportError:
        return False
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


def _is_file(handle: int, part: Path) -> bool:
    """True where the path names the file of the descriptor."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), part.stat())
    return False


def _taken(part: Path) -> InputError:
    """Error for a name that is taken by a recording."""
    return InputError(
        f"{part} is already there, a recording at work or cut off; "
        f"drft log repair {part}, or move it away"
    )
