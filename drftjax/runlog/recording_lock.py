"""Lock on a file that is recorded into: a recording at work, or one that was cut off.

The recorder holds a POSIX lock on the file, which the system lets go when the recorder ends in
whatever way. HDF5's own locks are of another kind (flock) and are not touched by it.
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


PART: str = ".part"


"""Suffix of a run log's name while it is recorded."""


def part_path(path: Path) -> Path:
    """Path of a run log while it is recorded."""
    return path.with_name(path.name + PART)


def require_free(path: Path) -> None:
    """Refuse a run log's name that is taken, by a run log or by a recording of it.

    Raises:
        InputError: says which file is there.
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
    """Take a run log's name for a recording, so that no other recorder can.

    Args:
        path: The final name.

    Returns:
        A descriptor of the file it is recorded into, which is empty and locked.

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
    """Let go of a name that was claimed, and remove its recording."""
    with suppress(InputError):
        place = place_of(handle, part_path(path))
        if place is not None:
            place.unlink(missing_ok=True)
    os.close(handle)


def hold_lock(handle: int, part: Path) -> None:
    """Take the lock through a file descriptor that is open for writing, for as long as it is open.

    The lock is also let go when this process closes any other descriptor of the same file.

    Raises:
        InputError: another process has it.
    """
    import fcntl  # here, as not every system has it

    try:
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:  # some network drives have no locks
        if error.errno in (errno.EACCES, errno.EAGAIN):
            raise _taken(part) from None


def place_of(handle: int, part: Path) -> Path | None:
    """Present path of the file of a recording: its folder may have been moved.

    Args:
        handle: The descriptor that it was claimed by.
        part: Where it was made.

    Returns:
        None where it was removed.

    Raises:
        InputError: it was moved, and the system does not tell where to.
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
    """True if another process records into the file now; False on a system without such locks."""
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
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), part.stat())
    return False


def _taken(part: Path) -> InputError:
    return InputError(
        f"{part} is already there, a recording at work or cut off; "
        f"drft log repair {part}, or move it away"
    )
