"""Putting a file in place whole, or not at all."""

import os
from contextlib import suppress
from pathlib import Path
from tempfile import mkstemp

from drftjax.errors import InputError


def replace_file(path: Path, data: bytes) -> None:
    """Write to a neighbour, fsync, rename: the name holds the old file or the new one.

    Args:
        path: Final name; what stood there is replaced.
        data: The whole file.
    """
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {folder}")
    if path.exists() and not path.is_file():
        # A rename would put a plain file in the place of a folder or a device.
        raise InputError(f"{path} cannot be written: it is not an ordinary file")
    try:
        handle, draft = mkstemp(prefix=".drft-", suffix=".part", dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                os.fchmod(file.fileno(), 0o666 & ~_umask())
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(draft).replace(path)
        except BaseException:  # an interrupt, too, leaves nothing behind
            with suppress(OSError):
                Path(draft).unlink()
            raise
        _sync_folder(folder)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path} cannot be written: {reason}") from error


def make_folder(folder: Path) -> None:
    """Make a folder for results, with those above it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{folder} cannot be made a folder: {reason}") from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself last through a power cut, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
