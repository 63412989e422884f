"""Files of results: names that share a stem, files put in place whole or not at all."""

import errno
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile, mkstemp

from drftjax.common.errors import InputError


def stem_of(output: Path, endings: Sequence[str]) -> Path:
    """What was given for a stem, without the ending if it has one of the results'.

    Raises:
        InputError: where it is a folder.
    """
    if output.is_dir() or not output.name:
        raise InputError(f"{output} is a folder; name the result too, such as {output / 'fit'}")
    return output.with_suffix("") if output.suffix in endings else output


def files_of(stem: Path, endings: Sequence[str]) -> list[Path]:
    """A file for each ending, after all of the stem's name: it may hold dots."""
    return [stem.with_name(stem.name + ending) for ending in endings]


def replace_file(path: Path, data: bytes) -> None:
    """Write to a neighbour, fsync, rename: the name holds the old file or the new one.

    Args:
        path: Final name; what stood there is replaced.
        data: The whole file.
    """
    _put(path, data, lambda draft: draft.replace(path))


def put_new_file(path: Path, data: bytes) -> None:
    """The same where nothing stands yet: whatever came there meanwhile stays.

    Args:
        path: Final name.
        data: The whole file.

    Raises:
        InputError: the name is taken, or cannot be written.
    """

    def link(draft: Path) -> None:
        try:
            path.hardlink_to(draft)
        except FileExistsError:
            raise
        except OSError:  # some drives have no hard links
            if path.exists():
                raise FileExistsError(errno.EEXIST, "it is already there") from None
            draft.replace(path)
        else:
            draft.unlink()

    _put(path, data, link)


def _put(path: Path, data: bytes, place: Callable[[Path], object]) -> None:
    folder = path.parent
    if not folder.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {folder}")
    _require_ordinary(path)
    try:
        handle, draft = mkstemp(prefix=".drft-", suffix=".part", dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                os.fchmod(file.fileno(), 0o666 & ~_umask())
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            place(Path(draft))
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


def require_folder(folder: Path) -> None:
    """Make a folder for results and try it out, before the work that leads to them.

    Raises:
        InputError: names the folder, where it cannot be made or nothing can be written there.
    """
    make_folder(folder)
    try:
        with TemporaryFile(prefix=".drft-", dir=folder):
            pass
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{folder}: nothing can be written there ({reason})") from error


def require_places(paths: Iterable[Path], inputs: Iterable[Path] = ()) -> None:
    """Refuse names of results that cannot be written, before the work that leads to them.

    Folders are made.

    Args:
        paths: The files to be.
        inputs: Files that are read, and that no result may replace.

    Raises:
        InputError: names the folder or the file, and why.
    """
    read = [each for each in inputs if each.exists()]
    for path in paths:
        require_folder(path.parent)
        _require_ordinary(path)
        if path.exists() and any(path.samefile(each) for each in read):
            raise InputError(f"{path} is read here and would be replaced; give another name")


def _require_ordinary(path: Path) -> None:
    if path.exists() and not path.is_file():
        # A rename would put a plain file in the place of a folder or a device.
        raise InputError(f"{path} cannot be written: it is not an ordinary file")


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
