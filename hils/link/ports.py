"""The port that the wire comes out of: a serial device, a socket, or any other pyserial URL.

Reads and writes never wait; waiting has a deadline of its own and can be cut short from another
thread. Whatever breaks is one `LinkLost`.
"""

import abc
import errno
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from drftjax.common.errors import InputError
from hils.link.link import LinkLost

# URLs of pyserial's that open a device of this computer.
DEVICE_URLS = ("hwgrep://", "spy://", "alt://")


LARGEST_BAUD = 12_000_000


@dataclass(frozen=True)
class PortSettings:
    """Buffers and time-outs of a port.

    Attributes:
        backlog: Bytes in the driver over which nothing is added; two commands, for more would be
            older than the newest by the time they are sent.
        send_buffer: Of a socket [bytes], for the same reason; the kernel counts its own
            bookkeeping with it.
        poll_interval: From one look at a full driver, or at a port without a descriptor, to the
            next [s].
        connect_time: For a socket to connect [s].
        write_time: For a write of pyserial's [s].
        leave_time: For the last bytes to leave a port that is closed [s].
    """

    backlog: int = 64
    send_buffer: int = 4096
    poll_interval: float = 1e-3
    connect_time: float = 5.0
    write_time: float = 1.0
    leave_time: float = 0.1


DEFAULT_PORT = PortSettings()


class AbstractPort(abc.ABC):
    """A stream of bytes both ways. All but `close` raise `LinkLost` where it breaks."""

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name for a person."""

    @abc.abstractmethod
    def read(self, limit: int) -> bytes:
        """Read at most so many bytes; nothing where nothing has come."""

    @abc.abstractmethod
    def write(self, data: bytes) -> int:
        """Hand over as many bytes as there is room for now, and say how many."""

    @abc.abstractmethod
    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        """Return once there may be something to read, or room to write, or at `wake`.

        Args:
            readable, writable: What to wait for.
            deadline: Latest return [s], on the monotonic clock.
        """

    @abc.abstractmethod
    def wake(self) -> None:
        """Make `wait` return, now or when it is called next; from any thread."""

    @abc.abstractmethod
    def close(self) -> None:
        """Let go of the port."""


class Waker:
    """A descriptor that becomes readable when another thread wants it."""

    def __init__(self):
        self._ends = os.pipe()
        for end in self._ends:
            os.set_blocking(end, False)

    def fileno(self) -> int:
        return self._ends[0]

    def wake(self) -> None:
        # A full pipe wakes just as well, and after `close` there is nobody to wake.
        with suppress(OSError):
            os.write(self._ends[1], b"\1")

    def clear(self) -> None:
        with suppress(BlockingIOError):
            os.read(self._ends[0], 4096)

    def close(self) -> None:
        ends, self._ends = self._ends, (-1, -1)
        for end in ends:
            if end >= 0:
                os.close(end)


def _poll(descriptor: int, waker: Waker, readable: bool, writable: bool, deadline: float) -> None:
    poll = select.poll()
    poll.register(waker, select.POLLIN)
    # A hang-up is reported whatever is asked for; the next read then says so.
    poll.register(descriptor, select.POLLIN * readable | select.POLLOUT * writable)
    # Rounded up: a wait that ends early would be waited again, without a pause.
    left = max(0.0, deadline - time.monotonic())
    if any(each == waker.fileno() for each, _ in poll.poll(-(-left * 1e3 // 1))):
        waker.clear()


@contextmanager
def _as_link_lost(name: str) -> Iterator[None]:
    """Whatever a port raises, as one `LinkLost`."""
    try:
        yield
    except Exception as error:
        # pyserial raises TypeError and termios.error besides OSError when a device goes away.
        raise LinkLost(f"{name} is lost: {_cause(error)}") from error


def _cause(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno and error.errno in errno.errorcode:
        return os.strerror(error.errno)
    return " ".join(str(error).split()) or type(error).__name__


def _close_to_others(descriptor: int) -> None:
    """Let no other program open a terminal as long as it is open here.

    pyserial's own lock stops only those programs that ask for one too. A pseudo-terminal is left
    alone: it would stay closed after a kill, for as long as its other end lives. On Linux a
    program with the rights of root opens it all the same.
    """
    import fcntl
    import termios

    with suppress(OSError, AttributeError):  # not every driver or system has it
        if not _is_pseudo_terminal(descriptor):
            fcntl.ioctl(descriptor, termios.TIOCEXCL)


def _is_pseudo_terminal(descriptor: int) -> bool:
    return os.ttyname(descriptor).startswith("/dev/pts/")


class SerialPort(AbstractPort):
    """A serial device that pyserial has opened and set up, used by its descriptor."""

    def __init__(self, device: Any, name: str, settings: PortSettings = DEFAULT_PORT):
        import termios

        self._device, self._name, self._settings = device, name, settings
        self._descriptor = device.fileno()
        self._full = False
        with _as_link_lost(name):
            attributes = termios.tcgetattr(self._descriptor)
            # pyserial leaves these two: a break must not become a zero byte or a signal, and with
            # VMIN of 1 a read of nothing means a hang-up and never an empty buffer.
            attributes[0] &= ~(termios.BRKINT | termios.IXANY)
            attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
            termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
        with suppress(Exception):  # what FTDI's latency timer needs; not every driver knows it
            device.set_low_latency_mode(True)
        self._waker = Waker()  # last: what fails before it leaves no descriptor open

    @property
    def name(self) -> str:
        return self._name

    def read(self, limit: int) -> bytes:
        with _as_link_lost(self._name):
            try:
                data = os.read(self._descriptor, limit)
            except BlockingIOError:
                return b""
        if not data:
            raise LinkLost(f"{self._name} is lost: it hung up")
        return data

    def write(self, data: bytes) -> int:
        with _as_link_lost(self._name):
            queued = self._queued()
            self._full = queued > 0 and queued + len(data) > self._settings.backlog
            if self._full:
                return 0
            try:
                return os.write(self._descriptor, data)
            except BlockingIOError:
                return 0

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        if writable and self._full:
            # The driver would take more, so it cannot tell when its queue is short again.
            writable, deadline = (
                False,
                min(deadline, time.monotonic() + self._settings.poll_interval),
            )
        with _as_link_lost(self._name):
            _poll(self._descriptor, self._waker, readable, writable, deadline)

    def wake(self) -> None:
        self._waker.wake()

    def close(self) -> None:
        with suppress(Exception):
            leave = time.monotonic() + self._settings.leave_time
            while self._queued() and time.monotonic() < leave:
                time.sleep(self._settings.poll_interval)
            # Without this, closing waits up to 30 s for a device that takes nothing.
            self._device.reset_output_buffer()
        with suppress(Exception):
            self._device.close()
        self._descriptor = -1
        self._waker.close()

    def _queued(self) -> int:
        try:
            return self._device.out_waiting
        except OSError:  # a driver that cannot tell; one that is gone says so when it is written to
            return 0


class SocketPort(AbstractPort):
    """A connected stream socket, or one end of a socket pair."""

    def __init__(
        self,
        connected: socket.socket,
        name: str = "the socket",
        settings: PortSettings = DEFAULT_PORT,
    ):
        self._socket, self._name = connected, name
        with _as_link_lost(name):
            connected.setblocking(False)
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, settings.send_buffer)
            if connected.family in (socket.AF_INET, socket.AF_INET6):
                connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._waker = Waker()

    @property
    def name(self) -> str:
        return self._name

    def read(self, limit: int) -> bytes:
        with _as_link_lost(self._name):
            try:
                data = self._socket.recv(limit)
            except BlockingIOError:
                return b""
        if not data:
            raise LinkLost(f"{self._name} is lost: it hung up")
        return data

    def write(self, data: bytes) -> int:
        with _as_link_lost(self._name):
            try:
                return self._socket.send(data)
            except BlockingIOError:
                return 0

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        with _as_link_lost(self._name):
            _poll(self._socket.fileno(), self._waker, readable, writable, deadline)

    def wake(self) -> None:
        self._waker.wake()

    def close(self) -> None:
        with suppress(OSError):
            self._socket.close()
        self._waker.close()


class UrlPort(AbstractPort):
    """Any other port of pyserial's, `loop://` among them; it is looked at each millisecond."""

    def __init__(self, device: Any, name: str, settings: PortSettings = DEFAULT_PORT):
        self._device, self._name, self._poll_interval = device, name, settings.poll_interval
        self._woken = threading.Event()

    @property
    def name(self) -> str:
        return self._name

    def read(self, limit: int) -> bytes:
        with _as_link_lost(self._name):
            return self._device.read(max(1, min(limit, self._device.in_waiting)))

    def write(self, data: bytes) -> int:
        with _as_link_lost(self._name):
            return self._device.write(data)

    def wait(self, readable: bool, writable: bool, deadline: float) -> None:
        with _as_link_lost(self._name):
            while not (writable or (readable and self._device.in_waiting)):
                left = deadline - time.monotonic()
                if left <= 0.0 or self._woken.wait(min(left, self._poll_interval)):
                    break
        self._woken.clear()

    def wake(self) -> None:
        self._woken.set()

    def close(self) -> None:
        with suppress(Exception):
            self._device.close()


def require_baud_rate(baud: int) -> None:
    """Refuse a rate [bit/s] that no line has.

    Raises:
        InputError: it is out of range.
    """
    if not 1 <= baud <= LARGEST_BAUD:
        raise InputError(f"baud rate is {baud}, must lie between 1 and {LARGEST_BAUD}")


def open_port(
    name: str, baud: int, exclusive: bool = True, settings: PortSettings = DEFAULT_PORT
) -> AbstractPort:
    """Open a port.

    Args:
        name: A device, or a URL of pyserial's: socket://host:port, loop://.
        baud: Rate of a serial line [bit/s].
        exclusive: Refuse a device that another program holds, and hold it against others.
        settings: Buffers and time-outs.

    Raises:
        InputError: the rate cannot be, or socket:// does not name a host and a port.
        LinkLost: the port cannot be opened.
    """
    require_baud_rate(baud)
    if name.lower().startswith("socket://"):
        connected = _connected(name, settings.connect_time)
        return _closed_on_failure(connected, name, SocketPort, settings)
    import serial

    # A write must have a deadline; without waiting at all, pyserial loses what does not fit.
    options: dict[str, Any] = {"timeout": 0.0, "write_timeout": settings.write_time}
    if "://" not in name or name.lower().startswith(DEVICE_URLS):
        options["exclusive"] = exclusive
    try:
        device = serial.serial_for_url(name, baudrate=baud, **options)
    except serial.SerialException as error:
        raise LinkLost(f"{name} cannot be opened: {_refusal(error, name)}") from error
    except Exception as error:
        # A URL that cannot be ends in whatever its handler stumbles over: KeyError, re.error.
        raise LinkLost(f"{name} cannot be opened: {_cause(error)}") from error
    if os.name == "posix" and isinstance(device, serial.Serial):
        if exclusive:
            _close_to_others(device.fileno())
        return _closed_on_failure(device, name, SerialPort, settings)
    return UrlPort(device, name, settings)


def _closed_on_failure(
    opened: Any,
    name: str,
    kind: Callable[[Any, str, PortSettings], AbstractPort],
    settings: PortSettings,
) -> AbstractPort:
    try:
        return kind(opened, name, settings)
    except BaseException:
        opened.close()
        raise


def _refusal(error: Any, name: str) -> str:
    if error.errno in (errno.EAGAIN, errno.EBUSY):
        return "another program uses it"
    if error.errno == errno.EACCES:
        return "permission denied; on most systems its users are in the group dialout"
    if error.errno == errno.ENOENT:
        return "there is no such port; 'drft hils ports' lists those that there are"
    # pyserial tells a file that is no terminal by the text of what stopped it alone.
    stopped = getattr(error.__context__, "args", ())
    if error.errno == errno.EISDIR or stopped[:1] == (errno.ENOTTY,):
        return "it is no serial port; 'drft hils ports' lists those that there are"
    return _cause(error)


def _connected(url: str, connect_time: float) -> socket.socket:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or port is None:
        raise InputError(f"{url} cannot be opened: it must be socket://host:port")
    try:
        return socket.create_connection((host, port), connect_time)
    except (OSError, UnicodeError) as error:
        raise LinkLost(f"{url} cannot be opened: {_cause(error)}") from error


class ListedPort(NamedTuple):
    """A serial port of this machine: its name, and what its adapter says that it is."""

    name: str
    description: str


def list_ports() -> list[ListedPort]:
    """The serial ports of this machine, by name."""
    from serial.tools.list_ports import comports

    found = [ListedPort(each.device, _description(each)) for each in comports()]
    return sorted(found)


def latency_timer(name: str) -> int | None:
    """Latency timer of an FTDI adapter [ms]; None for any other port."""
    setting = Path("/sys/bus/usb-serial/devices") / Path(name).resolve().name / "latency_timer"
    try:
        return int(setting.read_text())
    except (OSError, ValueError):
        return None


def _description(port: Any) -> str:
    known = [text for text in (port.description, port.manufacturer) if text and text != "n/a"]
    return ", ".join(dict.fromkeys(known)) or "nothing known of it"
