"""Sinks of the loop's rows: the recorder's process, or memory for tests and studies."""

from typing import Protocol

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog import record
from drftjax.runlog.header import Head
from drftjax.runlog.schema import ONLINE_NUMBERS
from hils.recording.row_stream import OnlineRow


class RowSink(Protocol):
    """Takes a run's rows without ever waiting; `hils.recording.recorder.Recorder` is one.

    Times are seconds from the run's start, increasing within each kind of row.
    """

    @property
    def alive(self) -> bool:
        """True while every row so far has been handed over."""
        ...

    @property
    def reason(self) -> str | None:
        """Reason why it is lost, as a sentence without its subject."""
        ...

    def require_room(self, head: Head) -> None:
        """Refuse a head as long as this one where it, or rows behind it, could not be taken.

        Nothing has moved yet.

        Raises:
            InputError: it could not be taken.
        """
        ...

    def begin(self, head: Head) -> None:
        """Take the head of the run log; called once, before any row."""
        ...

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        """Take a command: time [s], angular velocity [rad/s], carriage speed [m/s] if driven."""
        ...

    def measured(self, time: float, *values: float) -> None:
        """Take a reading: time [s] and the head's channels."""
        ...

    def online(self, row: OnlineRow) -> None:
        """Take a tick."""
        ...

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        """Take an event: time [s], `hils.events.Event` and its number."""
        ...

    def close(self, end_reason: str) -> object:
        """End the run log, with the reason of the run's end."""
        ...


class WrappedSink:
    """Passes a run's rows on to another sink; what sees them on their way derives from it."""

    def __init__(self, rows: RowSink):
        self._rows = rows

    @property
    def alive(self) -> bool:
        return self._rows.alive

    @property
    def reason(self) -> str | None:
        return self._rows.reason

    def require_room(self, head: Head) -> None:
        self._rows.require_room(head)

    def begin(self, head: Head) -> None:
        self._rows.begin(head)

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        self._rows.command(time, omega, vx)

    def measured(self, time: float, *values: float) -> None:
        self._rows.measured(time, *values)

    def online(self, row: OnlineRow) -> None:
        self._rows.online(row)

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        self._rows.event(time, code, arg)

    def close(self, end_reason: str) -> object:
        return self._rows.close(end_reason)


class InMemorySink:
    """Keeps a run's rows in memory.

    Attributes:
        head: Head of the run log, once it has begun.
        end_reason: Once it is closed.
    """

    def __init__(self):
        self.head: Head | None = None
        self.end_reason: str | None = None
        self.commands: list[tuple[float, ...]] = []
        self.readings: list[tuple[float, ...]] = []
        self.ticks: list[OnlineRow] = []
        self.events: list[tuple[float, int, float]] = []

    @property
    def alive(self) -> bool:
        return True

    @property
    def reason(self) -> str | None:
        return None

    def require_room(self, head: Head) -> None:
        pass

    def begin(self, head: Head) -> None:
        self.head = head

    def command(self, time: float, omega: float, vx: float | None = None) -> None:
        self.commands.append((time, omega) if vx is None else (time, omega, vx))

    def measured(self, time: float, *values: float) -> None:
        self.readings.append((time, *values))

    def online(self, row: OnlineRow) -> None:
        self.ticks.append(row)

    def event(self, time: float, code: int, arg: float = 0.0) -> None:
        self.events.append((time, int(code), arg))

    def close(self, end_reason: str) -> None:
        self.end_reason = self.end_reason or end_reason

    def run(self) -> record.RunLog:
        """The run as a run log.

        Raises:
            InputError: nothing was commanded or measured.
        """
        head = self.head
        if head is None or not self.commands or not self.readings:
            raise InputError("the run ended before anything was commanded and measured")
        online = None
        if head.online is not None and self.ticks:
            columns = dict(zip(OnlineRow._fields, np.array(self.ticks).T, strict=True))
            numbers = {name: getattr(head.online, name) for name in ONLINE_NUMBERS}
            kept = {"loop": head.online.loop, "meanings": head.online.flag_meanings}
            online = record.Online(**columns, **numbers, **kept)
        return record.RunLog(
            setup=head.setup,
            command=record.RecordedCommand(
                *np.array(self.commands).reshape(len(self.commands), -1).T
            ),
            measured=record.Measured(
                np.array([row[0] for row in self.readings]),
                **{
                    name: np.array([row[1 + place] for row in self.readings])
                    for place, name in enumerate(head.channels)
                },
            ),
            source=head.source,
            title=head.title,
            online=online,
            events=record.Events(
                *(np.array([row[place] for row in sorted(self.events)]) for place in range(3)),
                meanings=head.event_meanings,
            ),
            created=head.created,
            run_id=head.run_id,
            notes=head.notes,
            software=head.software,
            software_version=head.software_version,
        )
