"""Stream of a run's ticks to another program, by wrapping the row sink.

Each tick is one JSON object, which PlotJuggler and Foxglove read as it comes. It is sent from the
loop's thread by one call that never waits: a datagram, or a write into the pipe of a process that
serves Foxglove; a datagram costs no more than a write into a pipe, so it needs no process of its
own (`python -m tests.benchmarks.stream`). What finds no room, or nobody there, is dropped and
counted; nothing that happens here reaches the loop.
"""

import errno
import os
import select
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from typing import Final, Protocol

import msgspec

from drftjax.common.child_process import program
from drftjax.common.errors import InputError
from drftjax.runlog.header import Head
from hils.monitor.stream_address import StreamAddress, StreamKind
from hils.recording.row_stream import OnlineRow
from hils.recording.sinks import RowSink, WrappedSink

CAUSES: Final = {
    errno.ECONNREFUSED: "nobody listened there",
    errno.EAGAIN: "there was no room for it",
    errno.EPIPE: "the server had ended",
}

_SERVE: Final = program("hils.monitor.foxglove_process", "main")


@dataclass(frozen=True)
class StreamSettings:
    """Patience with a server of the stream, before anything moves.

    Attributes:
        start_time: Time in which it must listen [s]; it imports two packages, on a loaded computer.
        end_time: Time in which it must end before it is killed [s].
    """

    start_time: float = 30.0
    end_time: float = 3.0


DEFAULT_STREAM = StreamSettings()


class StreamLine(Protocol):
    """Takes messages without waiting."""

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises:
            OSError: it, or the one before, was not taken.
        """
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


class UdpLine:
    """Datagrams to one address.

    Args:
        address: Of the receiver.

    Raises:
        InputError: this computer has no way there.
    """

    def __init__(self, address: StreamAddress):
        self._socket = socket.socket(address.family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        try:
            # Connected, the system says where nobody listens.
            self._socket.connect(address.address)
        except OSError as error:
            self._socket.close()
            raise InputError(f"--stream {address.url}: {error.strerror}") from None

    def send(self, message: bytes) -> None:
        try:
            self._socket.send(message)
        except ConnectionRefusedError:
            # It tells of the datagram before; a receiver that has come since gets this one.
            self._socket.send(message)
            raise

    def close(self) -> None:
        self._socket.close()


class FoxgloveLine:
    """Pipe to a process that serves Foxglove (`hils.monitor.foxglove_process`).

    Args:
        address: At which it listens.
        settings: Patience.

    Raises:
        InputError: it cannot listen there.
    """

    def __init__(self, address: StreamAddress, settings: StreamSettings = DEFAULT_STREAM):
        self._settings = settings
        reading_end, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-c", _SERVE, address.host, str(address.port)],
                stdin=reading_end,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(reading_end)
        answer = self._answer()
        if answer != "ready":
            self.close()
            why = answer or f"the server has not answered in {settings.start_time:g} s, or ended"
            raise InputError(f"--stream {address.url}: {why}")

    def send(self, message: bytes) -> None:
        # Shorter than PIPE_BUF, so it is taken whole or not at all.
        os.write(self._pipe, message + b"\n")

    def close(self) -> None:
        if self._pipe < 0:
            return
        os.close(self._pipe)
        self._pipe = -1
        try:
            self._process.wait(self._settings.end_time)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _answer(self) -> str:
        """First line of the process; empty where there is none in time."""
        answers = self._process.stdout
        assert answers is not None
        if not select.select([answers], [], [], self._settings.start_time)[0]:
            return ""
        return answers.readline().decode().strip()


class TickStream:
    """Stream of ticks over one line.

    Args:
        line: Takes the messages.

    Attributes:
        ticks: Ticks that were to be sent.
        lost: Count of those that were not taken, by cause.
    """

    def __init__(self, line: StreamLine):
        self._line, self._encode = line, msgspec.json.Encoder().encode
        self.ticks = 0
        self.lost: Counter[str] = Counter()

    def rows(self, rows: RowSink) -> RowSink:
        """Wrap a sink: rows are recorded as before, and each tick is sent."""
        return _StreamedRows(rows, self)

    def send(self, numbers: dict[str, float]) -> None:
        """Send a tick's numbers, or count it as lost; one that is not finite is left out."""
        self.ticks += 1
        try:
            known = {name: value for name, value in numbers.items() if isfinite(value)}
            self._line.send(self._encode(known))
        except OSError as error:
            self.lost[_cause(error)] += 1

    def outcome(self, url: str) -> str:
        """Sentence on the ticks that were sent and lost."""
        causes = ", ".join(f"{count}: {cause}" for cause, count in self.lost.items())
        lost = f", {self.lost.total()} not taken ({causes})" if causes else ""
        return f"Stream to {url}: {self.ticks} ticks sent{lost}."


@contextmanager
def open_stream(
    address: StreamAddress | None, say: Callable[[str], None]
) -> Iterator[TickStream | None]:
    """Context with a stream; its outcome is said at the end.

    Args:
        address: Of the stream; None for no stream.
        say: Takes the outcome.

    Raises:
        InputError: the stream cannot be opened.
    """
    if address is None:
        yield None
        return
    line = UdpLine(address) if address.kind is StreamKind.UDP else FoxgloveLine(address)
    stream = TickStream(line)
    try:
        yield stream
    finally:
        line.close()
        if stream.ticks:
            say(stream.outcome(address.url))


class _StreamedRows(WrappedSink):
    """Row sink that sends the numbers of each tick."""

    def __init__(self, rows: RowSink, stream: TickStream):
        super().__init__(rows)
        self._stream = stream
        self._driven = True
        self._omega = self._vx = float("nan")
        self._names: tuple[str, ...] = ()
        self._newest: dict[str, float] = {}

    def begin(self, head: Head) -> None:
        self._driven = head.online is not None
        self._names = head.channels
        super().begin(head)

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        super().command(time, omega, vx)
        self._omega = omega
        if vx is not None:
            self._vx = vx
        if not self._driven:  # nothing is simulated, so nothing else comes on each tick
            self._send({"time": time, **self._measured()})

    def measured(self, time: float, *values: float) -> None:
        super().measured(time, *values)
        self._newest = dict(zip(self._names, values, strict=True))

    def online(self, row: OnlineRow) -> None:
        super().online(row)
        self._send(
            {
                "time": row.time,
                "zeta": row.zeta,
                **self._measured(),
                "sinkage_simulated": -row.z_sim,
                "x_simulated": row.x_sim,
                "vx_commanded": self._vx,
                "vx_simulated": row.vx_sim,
                "fx": row.fx_sim,
                "fz": row.fz_sim,
                "flags": row.flags,
                "age": row.age,
                "late": row.late,
            }
        )

    def _measured(self) -> dict[str, float]:
        """Numbers that every run has."""
        return {
            "sinkage_measured": -self._newest.get("z", float("nan")),
            "x_measured": self._newest.get("x", float("nan")),
            "omega_commanded": self._omega,
            "omega_measured": self._newest.get("omega", float("nan")),
        }

    def _send(self, numbers: dict[str, float]) -> None:
        self._stream.send({"timestamp": time.time(), **numbers})


def _cause(error: OSError) -> str:
    return CAUSES.get(error.errno or 0) or error.strerror or type(error).__name__
