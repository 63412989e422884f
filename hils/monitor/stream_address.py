"""Address of a stream: udp://HOST:PORT, or foxglove://HOST:PORT."""

import socket
from enum import Enum
from importlib.util import find_spec
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from drftjax.common.errors import InputError


class StreamKind(Enum):
    """Way in which another program gets the ticks."""

    UDP = "udp"  # a datagram each, sent to it
    FOXGLOVE = "foxglove"  # a WebSocket server, to which it connects


class StreamAddress(NamedTuple):
    """Address of a stream, whose host is known.

    Attributes:
        url: As it was given.
        kind: Way of the ticks.
        host, port: Of the other program, or of the server.
        family, address: As a socket takes them.
    """

    url: str
    kind: StreamKind
    host: str
    port: int
    family: int
    address: Any


def read_stream_address(url: str) -> StreamAddress:
    """Read the address of a stream, and look its host up.

    Raises:
        InputError: it is no such address, its host is not known, or a package that it needs is not
            installed.
    """
    kind, host, port = _parts(url)
    if kind is StreamKind.FOXGLOVE and find_spec("foxglove") is None:
        raise InputError(
            f"--stream {url} needs the package foxglove-sdk: pip install 'drftjax[foxglove]'"
        )
    transport = socket.SOCK_DGRAM if kind is StreamKind.UDP else socket.SOCK_STREAM
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=transport)[0]
    except (OSError, UnicodeError):
        raise InputError(f"--stream {url}: the host {host!r} is not known") from None
    return StreamAddress(url, kind, host, port, family, address)


def _parts(url: str) -> tuple[StreamKind, str, int]:
    """Kind, host and port of a URL that has these three and nothing else."""
    try:
        split = urlsplit(url)
        kind, host, port = StreamKind(split.scheme), split.hostname, split.port
        rest = split.path.strip("/") or split.query or split.fragment or split.username
    except ValueError:
        kind, host, port, rest = None, None, None, None
    if kind is None or not host or not port or rest:
        kinds = " or ".join(f"{each.value}://HOST:PORT" for each in StreamKind)
        raise InputError(f"--stream is {url!r}, must be {kinds}, the port from 1 to 65535")
    return kind, host, port
