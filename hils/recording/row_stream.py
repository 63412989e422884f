"""Rows on their way from the control loop to the recorder: bytes through a pipe.

    stream = length u32 | head (msgpack) | row | row | ... | end
    row    = kind u8 | float64 values, as many as the kind has columns
    end    = 255 u8  | length u16 | reason (UTF-8)

All little-endian. A row is shorter than PIPE_BUF, so the system takes it whole or not at all.
Whole numbers up to 2^53 pass through a float64 unchanged.
"""

import struct
from collections import namedtuple
from enum import IntEnum
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.header import Head
from drftjax.runlog.schema import COLUMNS

END: Final = 255


LONGEST_REASON: Final = 2000


"""Bytes of an end's reason that are kept."""


_LENGTH: Final = struct.Struct("<I")


_END: Final = struct.Struct("<BH")


class Kind(IntEnum):
    """Kind of a row: the group of the run log that it goes to."""

    COMMAND = 1
    MEASURED = 2
    ONLINE = 3
    EVENTS = 4


_ONLINE: Final = COLUMNS["online"]


# The last ones came later, and may be left out.
_LATER: Final = [place for place, each in enumerate(_ONLINE) if not each.optional][-1] + 1


OnlineRow = namedtuple(
    "OnlineRow", [each.name for each in _ONLINE], defaults=(0.0,) * (len(_ONLINE) - _LATER)
)
OnlineRow.__doc__ = """One tick of the loop: a row of `drftjax.runlog.record.Online`, by name."""


def columns(head: Head) -> dict[Kind, int]:
    """Number of values in a row of each kind, its time included."""
    return {kind: len(head.columns(kind.name.lower())) for kind in Kind}


def row_packer(kind: Kind, head: Head) -> struct.Struct:
    """Packs the kind's number and a row's values."""
    return struct.Struct(f"<B{columns(head)[kind]}d")


def pack_head(head: Head) -> bytes:
    """The stream's beginning."""
    packed = msgspec.msgpack.encode(head)
    return _LENGTH.pack(len(packed)) + packed


def pack_end(reason: str) -> bytes:
    """The stream's end."""
    text = reason.encode("utf-8", "replace")[:LONGEST_REASON]
    return _END.pack(END, len(text)) + text


class RowStream:
    """The receiving end: bytes in as they come, the head and rows out.

    Attributes:
        head: Once it has arrived.
        end_reason: Once the end has arrived.
    """

    def __init__(self) -> None:
        self.head: Head | None = None
        self.end_reason: str | None = None
        self._data = b""
        self._rows: dict[int, struct.Struct] = {}

    def feed(self, data: bytes) -> dict[Kind, NDArray[np.float64]]:
        """The rows that are whole now, by kind, shape (rows, columns), in their order."""
        self._data += data
        found: dict[int, list[tuple[float, ...]]] = {}
        at = self._take_head() if self.head is None else 0
        while self.head is not None and self.end_reason is None and at < len(self._data):
            kind = self._data[at]
            if kind == END:
                at += self._take_end(at)
                break
            row = self._rows[kind]
            if len(self._data) < at + row.size:
                break
            found.setdefault(kind, []).append(row.unpack_from(self._data, at)[1:])
            at += row.size
        self._data = self._data[at:]
        return {Kind(kind): np.array(rows) for kind, rows in found.items()}

    def _take_head(self) -> int:
        if len(self._data) < _LENGTH.size:
            return 0
        end = _LENGTH.size + _LENGTH.unpack_from(self._data)[0]
        if len(self._data) < end:
            return 0
        self.head = msgspec.msgpack.decode(self._data[_LENGTH.size : end], type=Head)
        self._rows = {int(kind): row_packer(kind, self.head) for kind in Kind}
        return end

    def _take_end(self, at: int) -> int:
        if len(self._data) < at + _END.size:
            return 0
        size = _END.size + _END.unpack_from(self._data, at)[1]
        if len(self._data) < at + size:
            return 0
        self.end_reason = self._data[at + _END.size : at + size].decode("utf-8", "replace")
        return size
