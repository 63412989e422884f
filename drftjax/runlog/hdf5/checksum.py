"""A checksum of a whole file, appended where the HDF5 library does not look.

fletcher32 guards the rows, but not the text of attributes, and a flipped bit in HDF5's own
bookkeeping can hang the library. So a file written here ends with 20 bytes: the mark, the
length and the CRC-32 of all that comes before. They are looked at before the library is let
near the file. A program that edits the file cuts them off: it is then read without a seal.
"""

import struct
from pathlib import Path
from typing import Final
from zlib import crc32

MARK: Final = b"\x89DRFTSUM"


_TRAILER: Final = struct.Struct("<8sQI")


_BLOCK: Final = 2**20


def with_checksum(data: bytes) -> bytes:
    """The file's bytes with the seal behind them."""
    return data + _TRAILER.pack(MARK, len(data), crc32(data))


def checksum_matches(path: Path) -> bool | None:
    """True if a file is unchanged since it was sealed; None where it carries no checksum."""
    size = path.stat().st_size - _TRAILER.size
    if size < 0:
        return None
    with path.open("rb") as file:
        file.seek(size)
        mark, length, checksum = _TRAILER.unpack(file.read(_TRAILER.size))
        if mark != MARK:
            return None
        file.seek(0)
        found, left = 0, size
        while left > 0 and (block := file.read(min(left, _BLOCK))):
            found = crc32(block, found)
            left -= len(block)
    return length == size and found == checksum
