"""Readings of a recorded run that the loop refused or doubted: found by flags or events, dropped.

Doubted are those of a sensor that was stuck, from its last change on, and those that came so late
that their time is not known.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.record import RunLog

# Words of /online's flags: a tick had a reading of its own, the loop refused it, it came late.
FRESH, REFUSED, OLD = "fresh", "refused", "old"

# Those of a channel that was stuck.
STUCK = {"stuck": "z", "x_stuck": "x"}


# Word of /events for a refused reading, with the value that was read.
READING_REFUSED = "reading_refused"


@dataclass(frozen=True)
class RefusalSettings:
    """Numbers that decide which reading an event means.

    Attributes:
        event_delay: Time by which an event may be written before or after its reading [s].
    """

    event_delay: float = 0.2


DEFAULT_REFUSAL = RefusalSettings()


def refused_readings(run: RunLog, settings: RefusalSettings = DEFAULT_REFUSAL) -> NDArray[np.bool_]:
    """Rows of /measured that the loop refused as jumps or as impossible heights, or doubted.

    Each tick with a fresh reading has the next row. Where their numbers differ, as in a run that
    was interrupted, the log does not show which rows they are, and none is returned.

    Args:
        run: Made in the loop or not.
        settings: Distance in time of an event and its reading.

    Returns:
        True for each such row, shape (samples,).
    """
    none = np.zeros(len(run.measured.time), bool)
    if run.online is None:
        return none | _refused_by_events(run, settings)
    bits = {word: bit for bit, word in run.online.meanings.items()}
    if not {FRESH, REFUSED} <= set(bits):
        return none

    def flagged(word: str) -> NDArray[np.bool_]:
        assert run.online is not None
        return (run.online.flags & bits.get(word, 0)) != 0

    fresh = flagged(FRESH)
    if fresh.sum() != len(none):
        return none
    found = (flagged(REFUSED) | flagged(OLD))[fresh]
    for word, channel in STUCK.items():
        values = getattr(run.measured, channel)
        if values is not None:
            found |= _since_last_change(flagged(word)[fresh], values)
    return found


def _since_last_change(stuck: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Rows that are stuck, and those before them with the same value; shape (samples,)."""
    piece = np.cumsum(np.r_[0, np.diff(values) != 0])
    return np.isin(piece, piece[stuck])


def _refused_by_events(run: RunLog, settings: RefusalSettings) -> NDArray[np.bool_]:
    """Refused rows of a run whose carriage was free, by the readings that its events name."""
    found = np.zeros(len(run.measured.time), bool)
    if run.events is None:
        return found
    codes = [code for code, word in run.events.meanings.items() if word == READING_REFUSED]
    refused = np.isin(run.events.code, codes)
    channels = [each for each in (run.measured.z, run.measured.x) if each is not None]
    for time, value in zip(run.events.event_time[refused], run.events.arg[refused], strict=True):
        same = np.any([each == value for each in channels], axis=0)
        near = same & (np.abs(run.measured.time - time) <= settings.event_delay)
        if near.any():
            away = np.where(near, np.abs(run.measured.time - time), np.inf)
            found[int(np.argmin(away))] = True
    return found


def drop_refused(run: RunLog, settings: RefusalSettings = DEFAULT_REFUSAL) -> RunLog:
    """The run without the readings that the loop refused.

    Args:
        run: Made in the loop or not.
        settings: See `refused_readings`.

    Raises:
        InputError: the loop refused them all.
    """
    kept = ~refused_readings(run, settings)
    if kept.all():
        return run
    if not kept.any():
        raise InputError("the loop refused all its readings; at least one must be sound")
    measured = run.measured
    return replace(run, measured=measured.select(kept))
