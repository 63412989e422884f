"""Queue of frames to send: commands yield to newer ones, the rest goes in order."""

import math
from collections import deque
from typing import NamedTuple

from drftjax.common.errors import InputError
from hils.link.messages import U32, Drive, EmergencyStop, Frame, Message, clock_us, encode

# Last messages among which the times of the commands are known.
TIMES_KEPT = 4096


class _Waiting(NamedTuple):
    message: Message
    data: bytes


class SendQueue:
    """Frames that wait to be sent.

    Args:
        first: Sequence number of the first message.

    Attributes:
        sent: Frames taken so far.
        bytes_sent: Their length.
        replaced: Commands that gave way to a newer one, or to an emergency stop.
        longest_pause: Longest time from one command of this session to the next [s].
        last_command: Time of its last command [s]; None before the first.
    """

    def __init__(self, first: int = 1):
        self._next = first & U32
        self._session = 0
        self._waiting: deque[_Waiting] = deque()
        self._commands: dict[int, float] = {}
        self.sent = self.bytes_sent = self.replaced = 0
        self.longest_pause = 0.0
        self.last_command: float | None = None

    def begin(self, session: int) -> None:
        """Stamp this session on all that follows, and forget what was not sent."""
        if not 0 < session <= 0xFFFF:
            raise InputError(f"session number {session} must lie between 1 and 65535")
        self._session = session
        self._waiting.clear()
        self._commands.clear()
        self.longest_pause, self.last_command = 0.0, None

    def put(self, message: Message, now: float) -> Frame:
        """Add a message at this time [s], as it will go out."""
        if isinstance(message, Drive):
            _require_finite(message)
        frame = Frame(message, self._session, self._next, clock_us(now))
        data = encode(frame)
        self._next = (frame.seq + 1) & U32
        if isinstance(message, Drive):
            if self.last_command is not None:
                self.longest_pause = max(self.longest_pause, now - self.last_command)
            self.last_command = self._commands[frame.seq] = now
            self._commands.pop((frame.seq - TIMES_KEPT) & U32, None)
        self._drop_superseded_by(message)
        self._waiting.append(_Waiting(message, data))
        return frame

    def sent_at(self, seq: int) -> float | None:
        """Time at which a command of this number was put [s]; None where no longer known."""
        return self._commands.get(seq)

    def take(self) -> bytes:
        """The next frame, or nothing."""
        if not self._waiting:
            return b""
        data = self._waiting.popleft().data
        self.sent += 1
        self.bytes_sent += len(data)
        return data

    def __len__(self) -> int:
        return len(self._waiting)

    def _drop_superseded_by(self, message: Message) -> None:
        """Drop what need not be sent any more once this message is."""
        if isinstance(message, EmergencyStop):
            superseded: tuple[type, ...] = (object,)
        elif isinstance(message, Drive):
            superseded = (Drive,)
        else:
            return
        kept = [each for each in self._waiting if not isinstance(each.message, superseded)]
        self.replaced += len(self._waiting) - len(kept)
        self._waiting = deque(kept)


def _require_finite(command: Drive) -> None:
    if not (math.isfinite(command.omega) and math.isfinite(command.vx)):
        raise InputError(
            f"a command must be finite, not omega = {command.omega} rad/s, vx = {command.vx} m/s"
        )
