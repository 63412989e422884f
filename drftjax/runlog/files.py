"""Run logs named on a command line, by file or by folder."""

from collections.abc import Sequence
from hashlib import file_digest
from pathlib import Path
from typing import Final

from drftjax.common.errors import InputError

HDF5_ENDINGS: Final = (".h5", ".hdf5")


def run_files(given: Sequence[Path]) -> list[Path]:
    """Run logs by files and folders; of a folder, those that lie directly in it.

    Raises:
        InputError: a folder holds none, or nothing is given.
    """
    found: list[Path] = []
    for path in given:
        if not path.is_dir():
            found.append(path)
            continue
        files = sorted(each for each in path.iterdir() if each.suffix in HDF5_ENDINGS)
        if not files:
            deeper = any(f for e in HDF5_ENDINGS for f in path.glob(f"*/*{e}"))
            hint = "; its folders do: name one of them" if deeper else ""
            raise InputError(
                f"{path}: the folder holds no run log (*{', *'.join(HDF5_ENDINGS)}){hint}"
            )
        found += files
    if not found:
        raise InputError("no run was given; name run logs, or a folder of them")
    return found


def drop_repeated_files(files: Sequence[Path]) -> tuple[list[Path], dict[str, str]]:
    """Drop files that equal an earlier one byte for byte.

    A recording that counted twice would look like two runs that agree to the last digit.

    Returns:
        The other files, and a sentence for each file that was dropped, by its name.
    """
    first: dict[str, Path] = {}
    kept: list[Path] = []
    left_out: dict[str, str] = {}
    for path in files:
        digest = digest_of(path)
        if digest is None or digest not in first:
            kept.append(path)
        else:
            what = "is given twice" if path == first[digest] else f"is the same as {first[digest]}"
            left_out[str(path)] = f"{path}: {what}; it counts once"
        if digest is not None:
            first.setdefault(digest, path)
    return kept, left_out


def digest_of(path: Path) -> str | None:
    """SHA-256 of a file; None for a missing or empty file, a folder or a device."""
    try:
        if not path.is_file() or path.stat().st_size == 0:
            return None
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except OSError:  # reading it will give the reason
        return None
