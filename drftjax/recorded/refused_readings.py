"""Readings of a recorded run that the loop refused: found by flags or events, and dropped."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.record import Measured, RunLog

# Words of /online's flags: a tick had a reading of its own, and the loop refused it.
FRESH, REFUSED = "fresh", "refused"


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
    """Rows of /measured that the loop refused as jumps or as impossible heights.

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
    fresh, refused = ((run.online.flags & bits[word]) != 0 for word in (FRESH, REFUSED))
    return refused[fresh] if fresh.sum() == len(none) else none


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
    channels = {name: values[kept] for name, values in measured.channels().items()}
    return replace(run, measured=Measured(time=measured.time[kept], **channels))
