"""The virtual rig's end of a line: a pseudo-terminal that looks like a serial port, or a socket."""

import abc
import contextlib
import os
import select
import socket
from pathlib import Path

from drftjax.common.errors import InputError

MOST_BYTES = 4096


class AbstractEnd(abc.ABC):
    """End of a line at which a host may plug in. Nothing here waits but `wait`."""

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name that a host opens: a device, or a pyserial URL."""

    @abc.abstractmethod
    def read(self) -> bytes:
        """Bytes that have come from the host."""

    @abc.abstractmethod
    def write(self, data: bytes) -> None:
        """Give bytes to the host; what nobody takes is lost, as behind any serial port."""

    @abc.abstractmethod
    def wait(self, seconds: float) -> None:
        """Return when the host has sent something, or after this time [s]."""

    @abc.abstractmethod
    def unplug(self) -> None:
        """Pull the plug: the host's port is gone."""

    @abc.abstractmethod
    def plug(self) -> None:
        """Plug in again, perhaps under another name."""


class PtyEnd(AbstractEnd):
    """A pseudo-terminal, raw from the start.

    Args:
        link: A symbolic link to it, for a name that stays; one that leads nowhere is replaced.

    Raises:
        InputError: the link's name is taken by something else, a rig's among them, or cannot be
            made.
    """

    def __init__(self, link: Path | None = None):
        self._link = link
        if link is not None and link.exists() and not link.is_symlink():
            raise InputError(f"{link}: is there already, and is no link to a pseudo-terminal")
        self._ends: tuple[int, int] | None = None
        self._name = ""
        self.plug()

    @property
    def name(self) -> str:
        return str(self._link or self._name)

    def read(self) -> bytes:
        if self._ends is None:
            return b""
        try:
            return os.read(self._ends[0], MOST_BYTES)
        except OSError:  # nothing there
            return b""

    def write(self, data: bytes) -> None:
        if self._ends is not None:
            with contextlib.suppress(OSError):  # nobody reads, and the buffer is full
                os.write(self._ends[0], data)

    def wait(self, seconds: float) -> None:
        select.select([] if self._ends is None else [self._ends[0]], [], [], max(seconds, 0.0))

    def unplug(self) -> None:
        if self._ends is None:
            return
        # Before the name can be given to another pseudo-terminal.
        if self._link is not None and self._leads_to() == self._name:
            self._link.unlink(missing_ok=True)
        for end in self._ends:
            os.close(end)
        self._ends = None

    def plug(self) -> None:
        if self._ends is not None:
            return
        if self._link is not None and self._link.is_char_device():
            raise InputError(
                f"{self._link}: leads to {self._leads_to()}, which is in use, perhaps by another "
                "rig; give another name, or remove the link"
            )
        import tty

        ours, theirs = os.openpty()
        # Held open, so that a host finds it raw whenever it comes, and may come and go.
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self._ends, self._name = (ours, theirs), os.ttyname(theirs)
        if self._link is not None:
            try:
                self._link.unlink(missing_ok=True)
                self._link.symlink_to(self._name)
            except OSError as error:
                raise InputError(f"{self._link}: cannot be made ({error.strerror})") from None

    def _leads_to(self) -> str | None:
        assert self._link is not None
        try:
            return str(self._link.readlink())
        except OSError:  # removed, or no link any more
            return None


class SocketEnd(AbstractEnd):
    """A TCP port of this computer; one host at a time.

    Args:
        port: Its number; 0 for any that is free.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, port: int = 0):
        self._listener: socket.socket | None = None
        self._host: socket.socket | None = None
        self._port = port
        self.plug()

    @property
    def name(self) -> str:
        return f"socket://127.0.0.1:{self._port}"

    def read(self) -> bytes:
        if self._host is None and self._listener is not None:
            with contextlib.suppress(OSError):
                self._host, _ = self._listener.accept()
                self._host.setblocking(False)
                self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._host is None:
            return b""
        try:
            data = self._host.recv(MOST_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        if self._host is None:
            return
        try:
            self._host.send(data)
        except BlockingIOError:
            return
        except OSError:
            self._hang_up()

    def wait(self, seconds: float) -> None:
        waited = [each for each in (self._host or self._listener,) if each is not None]
        select.select(waited, [], [], max(seconds, 0.0))

    def unplug(self) -> None:
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def plug(self) -> None:
        if self._listener is not None:
            return
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", self._port))
        except OSError as error:
            listener.close()
            reason = (error.strerror or str(error)).lower()
            raise InputError(f"port {self._port} cannot be listened at: {reason}") from None
        except OverflowError:
            listener.close()
            raise InputError(f"port {self._port} must lie between 0 and 65535") from None
        listener.listen(1)
        listener.setblocking(False)
        self._listener, self._port = listener, listener.getsockname()[1]

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None
