"""What is to be seen of a run at one moment, as the control program tells its live view.

Each scene says all there is to say, so that it does no harm when some are lost on the way. One is a
line of JSON; a number that is not known is null.
"""

import math
import select
from collections import deque
from typing import Final

import msgspec

from hils.events import Phase

INTERVAL: Final = 0.1


"""From one scene to the next while the loop runs [s]."""


# A write of at most so many bytes into a pipe is done whole or not at all.
WHOLE: Final[int] = getattr(select, "PIPE_BUF", 512)


# Sentences that are told, and what is shown of one.
MOST_WORDS, LONGEST_WORD = 3, 160


class RunStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A run at one moment.

    Attributes:
        phase: Where it is.
        time: From the start; below 0 before it [s].
        duration: Of the profile [s].
        title: What people call the run.
        port, output: Where the rig is, and the run log.
        real, simulated: Sinkage [m].
        zeta: In use [-].
        slip: By the commands [-].
        omega, vx: Commanded [rad/s, m/s].
        latest: The most over a deadline so far [s].
        age: Of the reading in use [s].
        missed, refused: Deadlines and readings so far.
        sent, received: Frames a second.
        dropped: Frames that did not count, so far.
        stopping: Why the run is being ended; empty where it is not.
        words: What was last told.
    """

    phase: Phase = Phase.CHECKING
    time: float | None = None
    duration: float | None = None
    title: str = ""
    port: str = ""
    output: str = ""
    real: float | None = None
    simulated: float | None = None
    zeta: float | None = None
    slip: float | None = None
    omega: float | None = None
    vx: float | None = None
    latest: float = 0.0
    age: float | None = None
    missed: int = 0
    refused: int = 0
    sent: float | None = None
    received: float | None = None
    dropped: int = 0
    stopping: str = ""
    words: list[str] = []

    def line(self) -> bytes:
        """The scene as it is sent; what is told is left out where it would be too long."""
        line = _ENCODER.encode(self) + b"\n"
        if len(line) > WHOLE:
            line = _ENCODER.encode(msgspec.structs.replace(self, words=[], title="")) + b"\n"
        return line if len(line) <= WHOLE else b"\n"


class StatusReader:
    """Bytes from a pipe into scenes; what is no scene is passed over."""

    def __init__(self):
        self._rest = b""

    def feed(self, data: bytes) -> list[RunStatus]:
        """The scenes that are complete with these bytes."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = []
        for line in lines:
            try:
                found.append(_DECODER.decode(line))
            except msgspec.DecodeError:
                continue
        return found


class RecentMessages:
    """The last sentences that were told, each as one short line of replace_unprintable text."""

    def __init__(self):
        self._kept: deque[str] = deque(maxlen=MOST_WORDS)

    def add(self, text: str) -> None:
        """One more."""
        self._kept.append(printable_line(text))

    def list(self) -> list[str]:
        """The oldest first."""
        return list(self._kept)


def printable_line(text: str) -> str:
    """A line without anything that a terminal could take for an order."""
    line = " ".join(text.split())
    line = "".join(each if each.isprintable() else "?" for each in line)
    return line if len(line) <= LONGEST_WORD else line[: LONGEST_WORD - 1] + "…"


def finite_or_none(value: float) -> float | None:
    """The number, or None where it is not finite."""
    return value if math.isfinite(value) else None


_ENCODER: Final = msgspec.json.Encoder()


_DECODER: Final = msgspec.json.Decoder(RunStatus)
