"""Result files: names that share a stem, atomic replacement, result folders."""

import errno
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile, mkstemp

from drftjax.common.errors import InputError


def stem_of(output: Path, endings: Sequence[str]) -> Path:
    """Return the common stem of several results from the path that the user gave.

    Args:
        output: Path with or without one of the endings.
        endings: Suffixes of the results.

    Raises:
        InputError: the path is a folder.
    """
    if output.is_dir() or not output.name:
        raise InputError(f"{output} is a folder; name the result too, such as {output / 'fit'}")
    return output.with_suffix("") if output.suffix in endings else output


def files_of(stem: Path, endings: Sequence[str]) -> list[Path]:
    """Path for each ending, appended to the whole name of the stem, which may hold dots."""
    return [stem.with_name(stem.name + ending) for ending in endings]


def replace_file(path: Path, data: bytes) -> None:
    """Write a file atomically: a temporary file beside it, fsync, rename.

    Args:
        path: Final name; an existing file is replaced.
        data: Contents of the file.

    Raises:
        InputError: the file cannot be written.
    """
    _put(path, data, lambda draft: draft.replace(path))


def put_new_file(path: Path, data: bytes) -> None:
    """Write a file atomically under a name that must be free; an existing file is kept.

    Args:
        path: Final name.
        data: Contents of the file.

    Raises:
        InputError: the name is taken, or cannot be written.
    """

    def link(draft: Path) -> None:
        """Give the draft its name, unless another file has it."""
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
    """Write a draft beside `path` and have `place` move it there."""
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
        except BaseException:  # an interrupt included
            with suppress(OSError):
                Path(draft).unlink()
            raise
        _sync_folder(folder)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path} cannot be written: {reason}") from error


def make_folder(folder: Path) -> None:
    """Create a folder for results and its parents.

    Raises:
        InputError: it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        taken = next(each for each in (*reversed(folder.parents), folder) if not each.is_dir())
        raise InputError(f"{folder} cannot be made a folder: {taken} is a file") from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{folder} cannot be made a folder: {reason}") from error


def require_folder(folder: Path) -> None:
    """Create a folder for results, and check that it can be written.

    Called before the computation of the results.

    Raises:
        InputError: names the folder that cannot be created or written.
    """
    make_folder(folder)
    try:
        with TemporaryFile(prefix=".drft-", dir=folder):
            pass
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{folder}: nothing can be written there ({reason})") from error


def require_places(paths: Iterable[Path], inputs: Iterable[Path] = ()) -> None:
    """Refuse result files that cannot be written, and create their folders.

    Called before the computation of the results.

    Args:
        paths: Result files.
        inputs: Files that are read, which no result may replace.

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
    """Refuse to replace a folder or a device."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path} cannot be written: it is not an ordinary file")


def _umask() -> int:
    """Permissions that new files of this process lack; it can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """Write the rename to disk, so that it survives a power failure, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
