"""Status of a run at one moment, as the control program sends it to its live view.

Each status is complete, so that it does no harm when some are lost on the way. One is a line of
JSON; a number that is not known is null.
"""

import math
import select
from typing import Final

import msgspec

from hils.events import Phase

INTERVAL: Final = 0.1


"""From one status to the next while the loop runs [s]."""


# A write of at most so many bytes into a pipe is done whole or not at all.
WHOLE: Final[int] = getattr(select, "PIPE_BUF", 512)


# Sentences that are sent, and characters of one that are shown.
MOST_MESSAGES, LONGEST_MESSAGE = 3, 160


class RunStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A run at one moment.

    Attributes:
        phase: Of the run.
        time: From the start; below 0 before it [s].
        duration: Of the profile [s].
        title: Of the run.
        port, output: Of the rig, and the run log.
        real, simulated: Sinkage [m].
        zeta: In use [-].
        slip: By the commands [-].
        omega, vx: Commanded [rad/s, m/s].
        latest: The most over a deadline so far [s].
        age: Of the reading in use [s].
        missed, refused: Deadlines and readings so far.
        sent, received: Frames a second.
        dropped: Frames that did not count, so far.
        stopping: Reason why the run is being ended; empty where it is not.
        words: Last sentences.
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
        """The status as it is sent; its sentences are left out where it would be too long."""
        line = _ENCODER.encode(self) + b"\n"
        if len(line) > WHOLE:
            line = _ENCODER.encode(msgspec.structs.replace(self, words=[], title="")) + b"\n"
        return line if len(line) <= WHOLE else b"\n"


class StatusReader:
    """Reads statuses from a pipe; a line that is none is passed over."""

    def __init__(self):
        self._rest = b""

    def feed(self, data: bytes) -> list[RunStatus]:
        """Statuses that are complete with these bytes."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = []
        for line in lines:
            try:
                found.append(_DECODER.decode(line))
            except msgspec.DecodeError:
                continue
        return found


def printable_line(text: str) -> str:
    """A line without anything that a terminal could take for a control sequence."""
    line = " ".join(text.split())
    line = "".join(each if each.isprintable() else "?" for each in line)
    return line if len(line) <= LONGEST_MESSAGE else line[: LONGEST_MESSAGE - 1] + "…"


def finite_or_none(value: float) -> float | None:
    """The number, or None where it is not finite."""
    return value if math.isfinite(value) else None


_ENCODER: Final = msgspec.json.Encoder()


_DECODER: Final = msgspec.json.Decoder(RunStatus)
