"""A link over a port, served by a thread of its own: nobody who uses it waits for the line."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from hils.clock import AbstractClock, MonotonicClock
from hils.link.link import AbstractLink, Arrival, Inbox, LinkLost, LinkQuality, quality_of
from hils.link.messages import Message
from hils.link.ports import AbstractPort
from hils.link.send_queue import SendQueue

CHUNK = 4096  # read at once [bytes]


NUMBERS_PER_SECOND = 2000


def first_number(time_of_day: float) -> int:
    """Sequence number of a link's first frame, at this time [s].

    It grows faster than commands do, so a rig that counts on over sessions takes a restarted host's
    frame as newer; and it stays below 2^31, so a rig that starts from zero does too. Each 12.4 days
    it starts again from 1: a rig that counts on since before that must be switched off and on.
    """
    return int(time_of_day * NUMBERS_PER_SECOND) % (1 << 31) or 1


@dataclass(frozen=True)
class PortLinkSettings:
    """Patience of a link with its line.

    Attributes:
        stall_time: A line that takes nothing for so long is lost [s].
        idle_time: Longest wait of the thread, for what `wake` may have missed [s].
        flush_time: For frames still to be sent when the link is closed [s].
        join_time: For the end of the thread [s]; it never waits longer than a port's own time-out.
    """

    stall_time: float = 1.0
    idle_time: float = 0.5
    flush_time: float = 0.25
    join_time: float = 5.0


DEFAULT_PORT_LINK = PortLinkSettings()


class PortLink(AbstractLink):
    """A link over a port.

    A thread reads and writes; the caller finds what came in a mailbox, and leaves there what is to
    be sent. The thread ends at `close`, and when the line is lost.

    Args:
        port: The port, which the link then owns.
        clock: Of the arrivals; it must run with real time.
        started: Called in the thread when it starts, as to give it a priority.
        settings: Patience with the line.
    """

    def __init__(
        self,
        port: AbstractPort,
        clock: AbstractClock | None = None,
        started: Callable[[], None] | None = None,
        settings: PortLinkSettings = DEFAULT_PORT_LINK,
    ):
        self._port = port
        self._clock = clock if clock is not None else MonotonicClock()
        self._started, self._settings = started, settings
        self._inbox, self._outbox = Inbox(), SendQueue(first_number(time.time()))
        self._changed = threading.Condition()
        self._rest = b""
        self._lost: str | None = None
        self._closing: float | None = None
        self._thread = threading.Thread(target=self._serve, name=f"link {port.name}", daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        return self._port.name

    def begin(self, session: int) -> None:
        with self._changed:
            self._require_line()
            self._outbox.begin(session)
            self._inbox.begin(session)

    def send(self, message: Message) -> int:
        with self._changed:
            self._require_line()
            frame = self._outbox.put(message, self._clock.now())
            self._inbox.receiver.note_sent(frame)
        self._port.wake()
        return frame.seq

    def sent_at(self, seq: int) -> float | None:
        with self._changed:
            return self._outbox.sent_at(seq)

    def newest(self) -> Arrival | None:
        with self._changed:
            self._require_line()
            return self._inbox.newest()

    def reports(self) -> list[Arrival]:
        with self._changed:
            self._require_line()
            return self._inbox.reports()

    def wait(self, deadline: float) -> bool:
        with self._changed:
            while True:
                self._require_line()
                if self._inbox.take_news():
                    return True
                left = deadline - self._clock.now()
                if left <= 0.0:
                    return False
                self._changed.wait(left)

    def quality(self) -> LinkQuality:
        with self._changed:
            return quality_of(self._clock.now(), self._inbox, self._outbox)

    def close(self) -> None:
        with self._changed:
            if self._closing is None:
                self._closing = time.monotonic() + self._settings.flush_time
        self._port.wake()
        self._thread.join(self._settings.join_time)
        self._lose(f"{self.name} was let go")
        with suppress(LinkLost):
            self._port.close()

    # The thread ------------------------------------------------------------------------------

    def _serve(self) -> None:
        try:
            if self._started is not None:
                self._started()
            progress = time.monotonic()
            while not self._finished():
                now = time.monotonic()
                if self._write() or not self._rest:
                    progress = now
                elif now - progress > self._settings.stall_time:
                    stall = self._settings.stall_time
                    raise LinkLost(f"{self.name} is lost: for {stall:g} s it has taken nothing")
                self._port.wait(True, bool(self._rest), self._latest(now))
                self._read()
        except LinkLost as lost:
            self._lose(str(lost))
        except BaseException as error:
            # Whoever waits for this link must hear of it, whatever it was.
            self._lose(f"{self.name} is lost: {type(error).__name__} {error}")

    def _write(self) -> bool:
        """Send as much as the line takes now; True where it took anything."""
        took = False
        while True:
            if not self._rest:
                with self._changed:
                    self._rest = self._outbox.take()
                if not self._rest:
                    return took
            count = self._port.write(self._rest)
            self._rest = self._rest[count:]
            took = took or count > 0
            if self._rest:
                return took

    def _read(self) -> None:
        data = self._port.read(CHUNK)
        if data:
            with self._changed:
                if self._inbox.take(data, self._clock.now()):
                    self._changed.notify_all()

    def _latest(self, now: float) -> float:
        closing = self._closing
        latest = now + self._settings.idle_time
        return latest if closing is None else min(closing, latest)

    def _finished(self) -> bool:
        with self._changed:
            if self._closing is None:
                return False
            sent = not self._rest and not len(self._outbox)
            return sent or time.monotonic() >= self._closing

    def _lose(self, reason: str) -> None:
        with self._changed:
            self._lost = self._lost or reason
            self._changed.notify_all()

    def _require_line(self) -> None:
        if self._lost is not None:
            raise LinkLost(self._lost)
