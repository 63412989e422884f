"""Exceptions that reach the user, and the words for a file that cannot be read."""

from collections.abc import Iterable
from pathlib import Path


class InputError(ValueError):
    """An input from outside (a file, a number, a name, a device) cannot be used.

    The message is one sentence: what was given, what must hold and where. The command line
    prints it without a traceback and exits with code 2.
    """


class RunError(InputError):
    """One of several runs cannot be used; the others can.

    Args:
        run: Name of the run, with which the message begins.
        why: Reason why it cannot be used.
    """

    def __init__(self, run: str, why: str) -> None:
        super().__init__(run, why)  # these arguments rebuild it when it is unpickled
        self.run, self.why = run, why

    def __str__(self) -> str:
        return ": ".join(self.args)


def did_you_mean(given: str, known: Iterable[str], most: int = 3, cutoff: float = 0.5) -> str:
    """Clause that names the nearest of the known names: "; did you mean 'a' or 'b'?".

    Args:
        given: Name that is not known.
        known: Names that are.
        most: Number of names shown.
        cutoff: Least likeness, from 0 to 1.

    Returns:
        The clause; empty where no name is near.
    """
    from difflib import get_close_matches  # a stop of the runs does without it

    near = get_close_matches(given, list(known), n=most, cutoff=cutoff)
    return f"; did you mean {' or '.join(map(repr, near))}?" if near else ""


def read_failure(path: Path, error: OSError) -> str:
    """Clause on a file that cannot be read, to stand after its name.

    Args:
        path: File that was to be read.
        error: Reason of the operating system.

    Returns:
        Such as "there is no such file; did you mean 'paper.toml'?".
    """
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return missing_path(path)
    if isinstance(error, IsADirectoryError):
        return "is a folder, must be a file"
    return f"cannot be read: {(error.strerror or str(error)).lower()}"


def missing_path(path: Path, kind: str | None = None) -> str:
    """Clause on a path that does not exist, with the nearest name in the same folder.

    Args:
        path: Path of a file or folder that is not there.
        kind: "file" or "folder", whichever must be there; both may where it is None and the path
            has no suffix.
    """
    if path.is_symlink():
        return f"is a link to {path.readlink()}, which is not there"
    # The first part of the path that is missing; the others are missing with it.
    missing = next(each for each in (*reversed(path.parents), path) if not each.exists())
    folder = missing.parent
    if not folder.is_dir():
        return f"there is no such path: {folder} is a file, must be a folder"
    if missing == path:
        said = f"there is no such {kind or ('file' if path.suffix else 'file or folder')}"
    else:
        said = f"there is no folder {missing}"
    try:
        names = [each.name for each in folder.iterdir() if missing == path or each.is_dir()]
    except OSError:  # a folder may be entered that must not be listed
        names = []
    return said + did_you_mean(missing.name, names, most=1, cutoff=0.6)


def require_input_folder(folder: Path, holds: str) -> None:
    """Refuse a folder that is not there, or is a file.

    Args:
        folder: The folder that is read.
        holds: Contents that it must have, in words, such as "sets of runs".

    Raises:
        InputError: names the folder, and the nearest one.
    """
    if not folder.exists():
        raise InputError(f"{folder}: {missing_path(folder, 'folder')}")
    if not folder.is_dir():
        raise InputError(f"{folder}: is a file, must be a folder of {holds}")
