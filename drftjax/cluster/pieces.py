"""Pieces of work that are sent to a cluster as bytes, known by their SHA-256."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Protocol

from drftjax.cluster.connection import CLUSTER_SETTINGS
from drftjax.common.errors import InputError, read_failure


class Piece(Protocol):
    """Work that a cluster does by itself."""

    @property
    def path(self) -> Path:
        """Place of its file or folder."""
        ...

    @property
    def digest(self) -> str:
        """SHA-256 of its bytes, in hexadecimal."""
        ...

    def read(self) -> bytes:
        """Return its bytes; InputError where they cannot be read, or are others than before."""
        ...


@dataclass(frozen=True)
class LogFile:
    """A run log's file.

    Attributes:
        path: Where it lies.
        digest: SHA-256 of its bytes, in hexadecimal.
    """

    path: Path
    digest: str

    @classmethod
    def at(cls, path: Path) -> "LogFile":
        """Return the log in a file.

        Raises:
            InputError: where it cannot be read.
        """
        return cls(path, digest_of(file_bytes(path)))

    def read(self) -> bytes:
        """Return the file's bytes, if they are still those of the digest."""
        return unchanged(file_bytes(self.path), self)


def digest_of(data: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal."""
    return sha256(data).hexdigest()


def unchanged(data: bytes, piece: Piece) -> bytes:
    """Return bytes that still have the piece's digest.

    Raises:
        InputError: where they have another.
    """
    if digest_of(data) != piece.digest:
        raise InputError(f"{piece.path}: has changed since this program was started")
    return data


def file_bytes(path: Path) -> bytes:
    """Return the contents of a run log's file.

    Raises:
        InputError: where it cannot be read, or is too large to be sent.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, must be a run log")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: must be an ordinary file")
        require_size(path.stat().st_size, path)
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {read_failure(path, error)}") from None


def require_size(size: int, path: Path) -> None:
    """Raise InputError for more bytes than are sent to a worker."""
    most = CLUSTER_SETTINGS.max_bytes
    if size > most:
        raise InputError(
            f"{path}: is larger than {most // 2**20} MiB, too large to be sent to a worker; leave "
            "--cluster out"
        )
