"""The receiving end of the wire: bytes in, frames that count out, the rest counted by cause."""

from collections import Counter, deque

from hils.link.messages import (
    DELIMITER,
    LONGEST_PACKET,
    Drop,
    EmergencyStop,
    Frame,
    HelloAck,
    StateReport,
    decode,
    is_newer,
)

# Emergency stops of its own that an end knows when a line echoes them.
ECHOES_KEPT = 16


class FrameSplitter:
    """Cuts a stream of bytes at its delimiters; keeps no more than one frame's worth of it."""

    def __init__(self):
        self._rest = b""
        self._skipping = False
        self.overlong = 0

    def packets(self, data: bytes) -> list[bytes]:
        """Packets that stand complete between two delimiters, in order and never empty."""
        *complete, rest = (self._rest + data).split(DELIMITER)
        if self._skipping and complete:
            complete[0] = b""
            self._skipping = False
        if len(rest) > LONGEST_PACKET and not self._skipping:
            self._skipping = True
            self.overlong += 1
        self._rest = b"" if self._skipping else rest
        return [packet for packet in complete if packet]


class Receiver:
    """Receiving end: frames that count, and causes of those that do not (docs/reference/wire.md).

    Args:
        accepts: Message types that this end takes: `hils.link.messages.FROM_RIG` at the host.

    Attributes:
        accepted: Frames that counted.
        foreign_state: Last state that came intact but did not count, of another session or out of
            order: a rig that was reset says so in one.
        foreign_stop: Last emergency stop that came so.
    """

    def __init__(self, accepts: tuple[type, ...]):
        self._accepts = frozenset(accepts)
        self._splitter = FrameSplitter()
        self._session: int | None = None
        self._last: int | None = None
        self._own: deque[Frame] = deque(maxlen=ECHOES_KEPT)
        self._drops: Counter[Drop] = Counter()
        self.accepted = 0
        self.foreign_state: HelloAck | StateReport | None = None
        self.foreign_stop: EmergencyStop | None = None

    def expect(self, session: int) -> None:
        """Count only frames of this session from here on, starting at any sequence number."""
        self._session, self._last = session, None
        self.foreign_state, self.foreign_stop = None, None

    def note_sent(self, frame: Frame) -> None:
        """Note a frame sent by this end: an emergency stop that a line echoes is its own."""
        if isinstance(frame.message, EmergencyStop):
            self._own.append(frame)

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that count among what these bytes complete."""
        frames = map(self._judge, self._splitter.packets(data))
        return [frame for frame in frames if frame is not None]

    @property
    def drops(self) -> dict[Drop, int]:
        """Count of dropped packets, by cause."""
        return dict(self._drops + Counter({Drop.OVERLONG: self._splitter.overlong}))

    def _judge(self, packet: bytes) -> Frame | None:
        found = decode(packet)
        if found in self._own:
            self._drops[Drop.DIRECTION] += 1
            return None
        if isinstance(found, Drop):
            cause = found
        elif type(found.message) not in self._accepts:
            cause = Drop.DIRECTION
        elif found.session != self._session:
            cause = Drop.SESSION
        elif self._last is not None and not is_newer(found.seq, self._last):
            cause = Drop.ORDER
        else:
            self._last = found.seq
            self.accepted += 1
            if isinstance(found.message, HelloAck):
                # What was still on the line of an earlier boot says nothing of this one.
                self.foreign_state = None
            return found
        self._drops[cause] += 1
        if isinstance(found, Frame) and isinstance(found.message, HelloAck | StateReport):
            self.foreign_state = found.message
        if isinstance(found, Frame) and isinstance(found.message, EmergencyStop):
            self.foreign_stop = found.message
        return None
