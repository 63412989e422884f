"""Rules for the axes, channels, numbers and texts of a run log, one sentence for each violation.

The same rules hold when a record is built, when a file is read and when a file is checked; the
first two stop at the first violation, the last lists all.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import did_you_mean

SOURCES: Final = ("measured", "virtual rig", "simulated", "imported")

POSITIVE: Final = frozenset(
    {"wheel_radius", "wheel_width", "mass_x", "mass_z", "gravity", "bulk_density"}
)

NOT_NEGATIVE: Final = frozenset(
    {"grouser_count", "grouser_height", "grouser_thickness", "scaling_factor_initial"}
)


def axis_problems(name: str, time: NDArray[np.float64], repeats: bool = False) -> Iterator[str]:
    """Violations by a time axis, which must be finite and increase from row to row.

    Args:
        name: Name of the axis in the sentences.
        time: Times, shape (rows,) [s].
        repeats: True where neighbours may be equal, as for two events on one tick.
    """
    finite = np.isfinite(time)
    if not finite.all():
        yield _not_finite(name, time)
        return
    steps = np.diff(time)
    wrong = np.flatnonzero(steps < 0 if repeats else steps <= 0)
    if wrong.size:
        row = int(wrong[0])
        yield (
            f"{name} must increase from row to row, but row {row + 1} is {time[row + 1]:g} s "
            f"after {time[row]:g} s ({wrong.size} such rows)"
        )


def channel_problems(name: str, values: NDArray[np.generic], rows: int, axis: str) -> Iterator[str]:
    """Violations by a channel, which must have one finite value for each row of its time axis.

    Args:
        name: Name of the channel in the sentences.
        values: Its values; right is the shape (rows,).
        rows: Number of rows of the axis.
        axis: Name of the axis.
    """
    if values.shape != (rows,):
        yield (
            f"{name} has {_extent(values.shape)} but {axis} has {rows} rows; the lengths must agree"
        )
    if not np.isfinite(values).all():
        yield _not_finite(name, values)


def setup_problems(name: str, value: float) -> Iterator[str]:
    """Violations by a number of the set-up, which must be finite and of a possible sign."""
    if not np.isfinite(value):
        yield f"{name} is {value}, it must be a finite number"
    elif name in POSITIVE and value <= 0:
        yield f"{name} is {value:g}, it must be above 0"
    elif name in NOT_NEGATIVE and value < 0:
        yield f"{name} is {value:g}, it must not be negative"
    elif name == "grouser_count" and value != int(value):
        yield f"{name} is {value:g}, it must be a whole number"


def text_problems(name: str, text: str) -> Iterator[str]:
    """Violations by a text, which may hold only characters that UTF-8 can encode, and no NUL."""
    odd = next((each for each in text if each == "\0" or "\ud800" <= each <= "\udfff"), None)
    if odd is not None:
        yield f"{name} holds the character {odd!r}, which cannot be written; leave it out"


def source_problems(source: str) -> Iterator[str]:
    """Violation by a source that is none of `SOURCES`."""
    if source not in SOURCES:
        yield f"source is {source!r}, it must be one of {', '.join(map(repr, SOURCES))}"


def nearest(name: str, known: "list[str] | tuple[str, ...]") -> str:
    """Hint that names the closest known words, or all of them where none is close."""
    if hint := did_you_mean(name, known):
        return hint.removeprefix("; ")
    return "known are " + ", ".join(known) if known else "there are none"


def _not_finite(name: str, values: NDArray[np.generic]) -> str:
    """Sentence on values that are not finite."""
    bad = np.flatnonzero(~np.isfinite(values.ravel()))
    return (
        f"{name} has {bad.size} values that are not finite, the first in row {bad[0]}; "
        "leave out a channel or a row that was not measured"
    )


def _extent(shape: tuple[int, ...]) -> str:
    """Shape of an array in words."""
    return f"{shape[0]} rows" if len(shape) == 1 else f"shape {shape}"
