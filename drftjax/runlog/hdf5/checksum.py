"""Checksum of a whole file, appended where the HDF5 library does not look.

fletcher32 guards the rows but not the text of attributes, and a flipped bit in HDF5's own
bookkeeping can hang the library. So a file written here ends with 20 bytes: a mark, and the length
and CRC-32 of all bytes before. They are checked before the library opens the file. A program that
edits the file removes them, and it is then read without this check.
"""

import struct
from pathlib import Path
from typing import Final
from zlib import crc32

MARK: Final = b"\x89DRFTSUM"


_TRAILER: Final = struct.Struct("<8sQI")


_BLOCK: Final = 2**20


def with_checksum(data: bytes) -> bytes:
    """Append the checksum to the bytes of a file."""
    return data + _TRAILER.pack(MARK, len(data), crc32(data))


def checksum_matches(path: Path) -> bool | None:
    """Compare a file with its checksum; None for a file without one."""
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
