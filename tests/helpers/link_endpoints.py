"""Far ends of links, to test hosts on: a terminal, a served rig and a scripted port.

Real time passes here. Deadlines are on what comes of it and generous (`PATIENCE`), for the machine
may be busy.
"""

import os
import pty
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import pytest

from drftjax.common.errors import InputError
from hils.link.framing import Receiver
from hils.link.link import LinkLost
from hils.link.messages import FROM_HOST, Drive, Hello
from hils.link.port_link import PortLink
from hils.link.ports import AbstractPort
from hils.procedure.session import Session
from hils.rig_sim.firmware import RigIdentity, RigProtocol

PATIENCE = 15.0
BAUD = 115_200
SESSION = 21
STILL = Drive(0.0, 0.0, False, 5000)
SLOW_TICK = Hello(
    1_000_000, 5000
)  # a watchdog of 5 s, which a busy machine does not meet by chance


def eventually(true: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(1e-3)


def lost(link: PortLink) -> str:
    """Wait until the link is lost; its reason."""

    def listen() -> None:
        while link.wait(time.monotonic() + PATIENCE):
            pass

    with pytest.raises(LinkLost) as error:
        listen()
    return str(error.value)


def acknowledged(link: PortLink) -> int | None:
    """Number of the command that the newest measurement answers."""
    newest = link.newest()
    return newest and newest.frame.message.ack_seq


def thread_of(link: PortLink) -> threading.Thread:
    return vars(link)["_thread"]


class Ends:
    """Pseudo-terminal: descriptor of the end of the rig, and name of the end of the host."""

    def __init__(self):
        self.rig, host = pty.openpty()
        self.name = os.ttyname(host)
        os.close(host)
        os.set_blocking(self.rig, False)

    def hang_up(self) -> None:
        rig, self.rig = self.rig, -1
        if rig >= 0:
            os.close(rig)

    def received(self, count: int) -> bytes:
        data = b""

        def enough() -> bool:
            nonlocal data
            with suppress(OSError):
                data += os.read(self.rig, 4096)
            return len(data) >= count

        eventually(enough)
        return data


class ServedRig:
    """Rig at one end of a socket pair, in a thread."""

    def __init__(self):
        self.host, self._socket = socket.socketpair()
        self._socket.settimeout(1e-3)
        self.protocol = RigProtocol(RigIdentity(boot_id=1), time.monotonic())
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._end.is_set():
            try:
                data = self._socket.recv(4096)
            except TimeoutError:
                data = b""
            except OSError:
                return
            out = self.protocol.advance(time.monotonic(), data)
            try:
                self._socket.sendall(out)
            except OSError:
                return

    def end(self) -> None:
        self._end.set()
        self._thread.join(PATIENCE)
        self._socket.close()


def is_armed(session: Session) -> bool:
    """True if the rig could be armed; on a busy machine, its quarter of a second may pass."""
    try:
        session.arm(STILL)
    except InputError:
        return False
    return True


class ScriptedPort(AbstractPort):
    """Port that reads and writes by a script."""

    def __init__(self, room: int = 1 << 20):
        self.room, self.taken = room, b""
        self.broken: Exception | None = None
        self.closed = False
        self._woken = threading.Event()

    @property
    def name(self) -> str:
        return "the scripted port"

    def read(self, limit: int) -> bytes:
        if self.broken is not None:
            raise self.broken
        return b""

    def write(self, data: bytes) -> int:
        self.taken += data[: self.room]
        return min(self.room, len(data))

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        if writable and self.room:
            return
        self._woken.wait(min(0.01, max(0.0, deadline - time.monotonic())))
        self._woken.clear()

    def wake(self) -> None:
        self._woken.set()

    def close(self) -> None:
        self.closed = True


def messages(data: bytes) -> list:
    receiver = Receiver(FROM_HOST)
    receiver.expect(SESSION)
    found = [frame.message for frame in receiver.feed(data)]
    assert receiver.drops == {}
    return found
