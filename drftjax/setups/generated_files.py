"""Set-up files that a command writes: replaced by its next result, unless somebody edited them."""

import zlib
from pathlib import Path

from drftjax.common.errors import InputError
from drftjax.common.output_files import replace_file

# Begins the last line, a comment with the checksum of all lines above.
SEAL = "# As written by drft; kept once it is edited. Checksum "


def replace_own_setup(path: Path, text: str, mark: str) -> None:
    """Put a set-up file in place of an earlier result.

    Args:
        path: The file.
        text: Its lines.
        mark: Words among them that all set-up files of this command hold.

    Raises:
        InputError: as `require_own_setup` does, and where the file cannot be written.
    """
    require_own_setup(path, mark)
    replace_file(path, f"{text}{SEAL}{_checksum(text)}\n".encode())


def require_own_setup(path: Path, mark: str) -> None:
    """Refuse the name of a set-up file that somebody wrote or edited.

    Args:
        path: A set-up file to be.
        mark: Words that the set-up files of this command hold.

    Raises:
        InputError: names the file, and the reason.
    """
    if not path.is_file():
        return
    text, sealed, checksum = path.read_text(encoding="utf-8", errors="replace").rpartition(SEAL)
    if not sealed or mark not in text:
        what = "is no earlier result of this command"
    elif checksum.strip() != _checksum(text):
        what = "has been edited since it was written"
    else:
        return
    raise InputError(f"{path} is there and {what}; give another name, or move it away")


def _checksum(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"
