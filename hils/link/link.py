"""Link between the loop and a rig: serial, virtual, or a test's."""

import abc
from collections import deque
from typing import NamedTuple, Protocol

import msgspec

from drftjax.common.errors import InputError
from hils.clock import AbstractClock, VirtualClock
from hils.link.framing import Receiver
from hils.link.messages import (
    FROM_RIG,
    Drop,
    EmergencyStop,
    Frame,
    HelloAck,
    Measurement,
    Message,
    StateReport,
)
from hils.link.send_queue import SendQueue

# Longer than the reports of a session; a rig that sends more loses its oldest, but no emergency
# stop: a question to the operator may stay open for long.
MOST_REPORTS = 256


# Step in which an in-process link looks for an answer [s].
GRAIN = 1e-3


class LinkLost(InputError):
    """The rig can no longer be reached; the message says what broke."""


class Arrival(NamedTuple):
    """A frame that counts, and when it came.

    Attributes:
        frame: What came.
        time: On the link's clock [s].
    """

    frame: Frame
    time: float


class LinkQuality(msgspec.Struct, frozen=True):
    """Traffic of a link since it was made. The difference of two gives rates.

    Attributes:
        time: On the link's clock [s].
        sent, received: Frames, only those that count.
        bytes_sent, bytes_received: All bytes.
        replaced: Commands that a newer one replaced before they were sent.
        longest_pause: Longest time without a command of this session, since its first [s].
        drops: Count of packets that did not count, by cause.
        foreign_state: Last state that came intact from another session or out of order.
        foreign_stop: Last emergency stop that came so.
    """

    time: float
    sent: int
    received: int
    bytes_sent: int
    bytes_received: int
    replaced: int
    longest_pause: float
    drops: dict[Drop, int]
    foreign_state: HelloAck | StateReport | None
    foreign_stop: EmergencyStop | None

    @property
    def dropped(self) -> int:
        """All that was received and did not count."""
        return sum(self.drops.values())


class AbstractLink(abc.ABC):
    """A line to one rig.

    Once the line is down every method raises `LinkLost`, but `quality` and `close` never do.
    """

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Name for a person: the port's."""

    @abc.abstractmethod
    def begin(self, session: int) -> None:
        """Send and count only frames of this session (1 to 65535) from here on.

        Nothing of the session before is returned or sent any more.
        """

    @abc.abstractmethod
    def send(self, message: Message) -> int:
        """Hand a message over, without waiting; its sequence number.

        Messages go in order. A command (`Drive`) replaces one that still waits, and an emergency
        stop replaces all that does.

        Raises:
            InputError: a number of it is not finite or does not fit its field.
        """

    @abc.abstractmethod
    def sent_at(self, seq: int) -> float | None:
        """Time at which a command of this session was handed over [s]; None where not known."""

    @abc.abstractmethod
    def newest(self) -> Arrival | None:
        """The newest measurement of this session; the same one again until there is a newer."""

    @abc.abstractmethod
    def reports(self) -> list[Arrival]:
        """All else that came since the last call, in order: HELLO_ACK, STATE, ESTOP."""

    @abc.abstractmethod
    def wait(self, deadline: float) -> bool:
        """Return once anything came since the last `wait`, `newest` or `reports`.

        Args:
            deadline: Latest return [s], on the link's clock.

        Returns:
            True where anything came.
        """

    @abc.abstractmethod
    def quality(self) -> LinkQuality:
        """Traffic of the link so far."""

    @abc.abstractmethod
    def close(self) -> None:
        """Send what was handed over, for a moment at most, and let go of the port."""


class Inbox:
    """Frames that came over a link and were not yet taken.

    Attributes:
        bytes_received: All bytes, whatever they were.
    """

    def __init__(self):
        self._receiver = Receiver(FROM_RIG)
        self._newest: Arrival | None = None
        self._reports: deque[Arrival] = deque()
        self._news = False
        self.bytes_received = 0

    @property
    def receiver(self) -> Receiver:
        return self._receiver

    def begin(self, session: int) -> None:
        """Count only this session's frames, and forget the one before."""
        self._receiver.expect(session)
        self._newest, self._news = None, False
        self._reports.clear()

    def take(self, data: bytes, time: float) -> bool:
        """Bytes that came at this time [s]; whether a frame was among them."""
        self.bytes_received += len(data)
        frames = self._receiver.feed(data)
        for frame in frames:
            arrival = Arrival(frame, time)
            if isinstance(frame.message, Measurement):
                self._newest = arrival
            else:
                self._keep(arrival)
        self._news = self._news or bool(frames)
        return bool(frames)

    def newest(self) -> Arrival | None:
        """The newest measurement."""
        self._news = False
        return self._newest

    def reports(self) -> list[Arrival]:
        """All else since the last call."""
        self._news = False
        taken = list(self._reports)
        self._reports.clear()
        return taken

    def take_news(self) -> bool:
        """Return True where anything came since this or the other two were last called."""
        news, self._news = self._news, False
        return news

    def _keep(self, arrival: Arrival) -> None:
        self._reports.append(arrival)
        if len(self._reports) <= MOST_REPORTS:
            return
        stops = [isinstance(each.frame.message, EmergencyStop) for each in self._reports]
        del self._reports[0 if all(stops) else stops.index(False)]


def quality_of(time: float, inbox: Inbox, outbox: SendQueue) -> LinkQuality:
    """Collect the counts of a link's two ends."""
    receiver = inbox.receiver
    return LinkQuality(
        time,
        outbox.sent,
        receiver.accepted,
        outbox.bytes_sent,
        inbox.bytes_received,
        outbox.replaced,
        _longest_pause(time, outbox),
        receiver.drops,
        receiver.foreign_state,
        receiver.foreign_stop,
    )


def _longest_pause(time: float, outbox: SendQueue) -> float:
    last = outbox.last_command
    return outbox.longest_pause if last is None else max(outbox.longest_pause, time - last)


class SteppedRig(Protocol):
    """A rig, or rig and line, that is advanced in time by its caller.

    Times never go back, and the same time may be given again.
    """

    def advance(self, now: float, data: bytes) -> bytes:
        """Live up to this time [s], take these bytes then, and give what has come out.

        Raises:
            LinkLost: the line is down.
        """
        ...


class InProcessLink(AbstractLink):
    """A link without threads, in the caller's time: what is sent arrives at once.

    Args:
        rig: At the other end.
        clock: A `VirtualClock` advances the rig whenever someone sleeps; by any other clock the
            rig lives in the calls of this link.
        name: Used in errors.
    """

    def __init__(self, rig: SteppedRig, clock: AbstractClock, name: str = "the virtual rig"):
        self._rig, self._clock, self._name = rig, clock, name
        self._inbox, self._outbox = Inbox(), SendQueue()
        self._lost: str | None = None
        self._carried = isinstance(clock, VirtualClock)
        if isinstance(clock, VirtualClock):
            clock.attach(self)

    @property
    def name(self) -> str:
        return self._name

    def begin(self, session: int) -> None:
        self._require_line()
        self._outbox.begin(session)
        self._inbox.begin(session)

    def send(self, message: Message) -> int:
        self._require_line()
        frame = self._outbox.put(message, self._clock.now())
        self._inbox.receiver.note_sent(frame)
        self._exchange(self._outbox.take())
        self._require_line()
        return frame.seq

    def sent_at(self, seq: int) -> float | None:
        return self._outbox.sent_at(seq)

    def newest(self) -> Arrival | None:
        self._look()
        return self._inbox.newest()

    def reports(self) -> list[Arrival]:
        self._look()
        return self._inbox.reports()

    def wait(self, deadline: float) -> bool:
        self._look()
        while not (news := self._inbox.take_news()) and self._clock.now() < deadline:
            self._clock.sleep_until(min(deadline, self._clock.now() + GRAIN))
            self._look()
        return news

    def quality(self) -> LinkQuality:
        return quality_of(self._clock.now(), self._inbox, self._outbox)

    def close(self) -> None:
        self._lost = self._lost or f"{self._name} was let go"

    def advance(self, now: float) -> None:
        """Let the rig live up to this time [s]; the clock calls it."""
        if self._lost is None:
            self._exchange(b"")

    def _look(self) -> None:
        self._require_line()
        if not self._carried:
            self._exchange(b"")
            self._require_line()

    def _exchange(self, data: bytes) -> None:
        now = self._clock.now()
        try:
            self._inbox.take(self._rig.advance(now, data), now)
        except LinkLost as lost:
            self._lost = str(lost)

    def _require_line(self) -> None:
        if self._lost is not None:
            raise LinkLost(self._lost)
