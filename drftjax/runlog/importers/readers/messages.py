"""Messages of a robot's log as columns: the topics of an MCAP file or a bag."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from drftjax.runlog.importers.table import Cells, Table, named_tables

MAX_ELEMENTS: Final = 64
"""Most elements of an array inside a message: a list of joints, not an image."""

LOG_TIME: Final = "log_time"
"""Heading of the time at which a message was recorded [ns since 1970]."""

STAMP: Final = "header.stamp"
"""Heading of the time that a message itself states [ns since 1970]."""


def message_fields(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers and texts of a message, fields by a dot, elements by a number from 0 in brackets.

    A stamp of seconds and nanoseconds is one whole number of nanoseconds.

    Args:
        name: Name of the field; "" for the message.
        value: Its value: number, text, list, mapping, or an object with fields.
    """
    fields = _fields(value)
    if fields is not None:
        seconds, rest = fields.get("sec"), fields.get("nanosec", fields.get("nsec"))
        if isinstance(seconds, int) and isinstance(rest, int):
            yield name, seconds * 1_000_000_000 + rest
            return
        for field, inner in fields.items():
            yield from message_fields(f"{name}.{field}" if name else field, inner)
    elif isinstance(value, str | bool | int | float | np.generic):
        yield name, value.item() if isinstance(value, np.generic) else value
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= MAX_ELEMENTS:
        for place, inner in enumerate(value):
            yield from message_fields(f"{name}[{place}]", inner)


def _fields(value: Any) -> dict[str, Any] | None:
    """Fields of a message by name; None for a plain value."""
    if isinstance(value, Mapping):
        return {str(name): each for name, each in value.items()}
    names = getattr(value, "__dataclass_fields__", None) or getattr(value, "__slots__", None)
    if names is None or isinstance(value, np.generic | np.ndarray):
        return None
    return {
        name: getattr(value, name) for name in names if not name.startswith("_") and name.islower()
    }


def message_columns(messages: list[dict[str, Any]]) -> dict[str, Cells]:
    """Columns of the messages of a topic; a field that a message lacks is a gap.

    Args:
        messages: Fields of each message by name.
    """
    names = dict.fromkeys(name for each in messages for name in each)
    return {name: _column([each.get(name) for each in messages]) for name in names}


def _column(values: list[Any]) -> Cells:
    """Values as text, as whole numbers, or as real numbers with gaps."""
    if any(isinstance(each, str) for each in values):
        return ["" if each is None else str(each) for each in values]
    if all(isinstance(each, int) for each in values):
        try:
            return np.array(values, dtype=np.int64)
        except OverflowError:
            pass
    return np.array([np.nan if each is None else float(each) for each in values])


def topic_tables(path: Path, topics: Mapping[str, Mapping[str, Cells]]) -> list[Table]:
    """Tables by topic; a sole one needs no name.

    Args:
        path: The file.
        topics: Cells by heading, by topic.
    """
    return named_tables(path, topics, "message", units={LOG_TIME: "ns", STAMP: "ns"})
