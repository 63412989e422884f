"""Rows made fit for a run log, which holds no infinite value and whose times increase.

What the loop hands over at a bad moment must not cost the whole file: a reader refuses one with
a single value that is not finite.
"""

import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.schema import COLUMNS
from hils.events import Event, TickFlag
from hils.recording.row_stream import Kind, OnlineRow

Rows = NDArray[np.float64]


_FLAGS = OnlineRow._fields.index("flags")


_INTEGERS = tuple(
    (place, each.integer) for place, each in enumerate(COLUMNS["online"]) if each.integer
)


class RowSanitizer:
    """Remembers the last time of each kind. What it returns can be appended to a run log."""

    def __init__(self) -> None:
        self._last = dict.fromkeys(Kind, -np.inf)

    def sanitize(self, kind: Kind, rows: Rows) -> tuple[Rows, Rows]:
        """Make rows fit to be kept, and events of those that cannot.

        Args:
            kind: Kind of the rows.
            rows: As they came, shape (rows, columns), time first.

        Returns:
            The rows: a time that does not increase moves up to the next float64 (events may
            share one); a tick's infinite value or NaN is 0, and NOT_FINITE among its flags; a
            command or a reading with one is left out. And the events, shape (_, 3), not yet
            sound themselves.
        """
        wrong = ~np.isfinite(rows)
        kept = np.where(wrong, 0.0, rows)
        whole = kind in (Kind.COMMAND, Kind.MEASURED)
        bad = wrong.any(axis=1) if whole else wrong[:, 0]
        if kind is Kind.ONLINE:
            odd = wrong.any(axis=1)
            kept[odd, _FLAGS] = kept[odd, _FLAGS].astype(np.uint32) | TickFlag.NOT_FINITE
        kept = kept[~bad]
        for column, limits in _INTEGERS if kind is Kind.ONLINE else ():
            low, size = limits.min, limits.max - limits.min + 1
            kept[:, column] = np.mod(np.round(kept[:, column]) - low, size) + low
        self._put_in_order(kind, kept)
        return kept, self._events_of(kind, rows[bad])

    def _put_in_order(self, kind: Kind, rows: Rows) -> None:
        time = rows[:, 0]
        repeats = kind == Kind.EVENTS
        for row, now in enumerate(time):
            last = self._last[kind]
            if not (now >= last if repeats else now > last):
                time[row] = last if repeats else np.nextafter(last, np.inf)
            self._last[kind] = time[row]

    def _events_of(self, kind: Kind, bad: Rows) -> Rows:
        last = self._last[Kind.EVENTS]
        when = np.where(np.isfinite(bad[:, 0]), bad[:, 0], last if np.isfinite(last) else 0.0)
        codes = np.full(len(bad), float(Event.ROW_NOT_FINITE))
        return np.column_stack([when, codes, np.full(len(bad), float(kind))])
