"""Append-only file of finished work, from which a killed program goes on.

JSON lines. The first names the settings of all work in the file, every other holds one piece of
it, such as a fitted run log, known by the SHA-256 of what it was made of. Each line begins with the
CRC-32 of the object without it. Lines are only ever appended, and synced before more is sent for,
so a kill at any moment leaves at most one line without its end, which is cut off when the store is
opened again.
"""

import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from zlib import crc32

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.output_files import make_folder

SCHEMA_VERSION: Final = 1


_CHECKED: Final = re.compile(rb'\{"crc32":"([0-9a-f]{8})",(.*\})\n', re.DOTALL)


def _unchanged(settings: dict[str, Any]) -> dict[str, Any]:
    return settings


@dataclass(frozen=True)
class StoreKind:
    """Kind of work that a store keeps.

    Attributes:
        schema: Its name in the first line.
        work: What the work is called in sentences, such as "fits".
        piece: What a piece of it was made of, such as "log".
        current: Settings as this version writes them, from those of an earlier file.
    """

    schema: str
    work: str
    piece: str
    current: Callable[[dict[str, Any]], dict[str, Any]] = _unchanged


class StoreHeader(msgspec.Struct, forbid_unknown_fields=True):
    """First line of the file.

    Attributes:
        settings: What all work in the file was done with, by name.
    """

    schema: str
    schema_version: int
    settings: dict[str, Any]


class FinishedWork(msgspec.Struct, forbid_unknown_fields=True):
    """One piece of work, such as one fitted run log.

    Attributes:
        digest: SHA-256 of what it was made of, in hexadecimal.
        log: Where that lay.
        values: Value and standard error by name, to be read by people; null is not finite, or not
            known.
        result: The whole result.
    """

    digest: str
    log: str
    values: dict[str, tuple[float | None, float | None]]
    result: bytes


class WorkStore:
    """Finished work of one kind and of one set of settings. Use as a context manager.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path, kind: StoreKind, settings: dict[str, Any]):
        """Open the file, or begin it.

        Args:
            path: The file.
            kind: Kind of its work.
            settings: What all its work is done with, as plain values.

        Raises:
            InputError: where it is damaged, in use, or of other settings.
        """
        self.path = path
        self._kind = kind
        self._places: dict[str, tuple[int, int]] = {}
        make_folder(path.parent)
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: must be an ordinary file to keep {kind.work} in")
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError(f"{path} cannot be opened: {reason}") from None
        try:
            self._lock()
            # As JSON gives them back: a tuple is a list.
            plain = msgspec.json.decode(msgspec.json.encode(settings))
            self._read(_line(StoreHeader(kind.schema, SCHEMA_VERSION, plain)), plain)
        except BaseException:
            os.close(self._handle)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._handle)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, digest: object) -> bool:
        return digest in self._places

    def append(self, finished: Iterable[FinishedWork]) -> None:
        """Append work; what is there already is not kept twice."""
        for each in finished:
            if each.digest not in self:
                place = os.fstat(self._handle).st_size
                self._places[each.digest] = place, self._write(_line(each))
        os.fsync(self._handle)

    def result(self, digest: str) -> bytes:
        """Return the whole result of one piece."""
        place, length = self._places[digest]
        line = os.pread(self._handle, length, place)
        return msgspec.json.decode(_checked(line), type=FinishedWork).result

    def _lock(self) -> None:
        import fcntl  # not on every system; nothing else of this module needs it

        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{self.path}: is in use by another program") from None

    def _write(self, line: bytes) -> int:
        left = memoryview(line)
        while left:
            left = left[os.write(self._handle, left) :]
        return len(line)

    def _read(self, first: bytes, settings: dict[str, Any]) -> None:
        """Read the places of the work, and cut off a line without its end."""
        place = 0
        with os.fdopen(os.dup(self._handle), "rb") as file:
            file.seek(0)
            for number, line in enumerate(file, start=1):
                if not line.endswith(b"\n") and (number > 1 or first.startswith(line)):
                    break
                if number > 1:
                    self._learn(line, number, place)
                else:
                    other = self._settings(line)
                    if other != settings and not file.peek(1):
                        break  # a call that finished nothing left this: it is begun again
                    self._compare(other, settings)
                place += len(line)
        os.ftruncate(self._handle, place)
        if place == 0:
            self._write(first)
            os.fsync(self._handle)

    def _settings(self, line: bytes) -> dict[str, Any]:
        """Settings in the first line, of the work below it."""
        try:
            header = msgspec.json.decode(_checked(line), type=StoreHeader)
        except ValueError:
            raise InputError(
                f"{self.path}: is damaged in line 1, or no store of {self._kind.work} at all; "
                "move it away to begin again"
            ) from None
        if (header.schema, header.schema_version) != (self._kind.schema, SCHEMA_VERSION):
            raise InputError(
                f"{self.path}: is a {header.schema!r} of version {header.schema_version}, must be "
                f"a {self._kind.schema!r} of version {SCHEMA_VERSION}"
            )
        return self._kind.current(header.settings)

    def _compare(self, other: dict[str, Any], settings: dict[str, Any]) -> None:
        for name in [*settings, *other]:
            if other.get(name) != settings.get(name):
                raise InputError(
                    f"{self.path}: holds {self._kind.work} with {name} {_words(other.get(name))}, "
                    f"not {_words(settings.get(name))}; give another name for these results"
                )

    def _learn(self, line: bytes, number: int, place: int) -> None:
        try:
            digest = msgspec.json.decode(_checked(line), type=FinishedWork).digest
        except ValueError:
            raise InputError(
                f"{self.path}: is damaged in line {number}; delete that line, and its "
                f"{self._kind.piece} is done again"
            ) from None
        self._places[digest] = place, len(line)


def _line(content: StoreHeader | FinishedWork) -> bytes:
    body = msgspec.json.encode(content)
    return b'{"crc32":"%08x",' % crc32(body) + body[1:] + b"\n"


def _checked(line: bytes) -> bytes:
    """Return the object that a line holds, without its checksum.

    Raises:
        ValueError: where the checksum does not match.
    """
    found = _CHECKED.fullmatch(line)
    body = b"{" + found[2] if found else b""
    if found is None or crc32(body) != int(found[1], 16):
        raise ValueError
    return body


def _words(value: Any) -> str:
    return msgspec.json.encode(value).decode()
