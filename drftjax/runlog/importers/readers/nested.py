"""Columns from nested values: the variables of a MAT file, the messages of a topic."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.importers.table import Cells

MAX_ELEMENTS: Final = 64
"""Most elements of an array inside a message: a list of joints, not an image."""


def variable_columns(name: str, value: Any) -> Iterator[tuple[str, Cells]]:
    """Columns of a variable: fields by a dot, elements and columns by a number from 1.

    Args:
        name: Name of the variable.
        value: Number, text, array, or a mapping of them.
    """
    if isinstance(value, Mapping):
        for field, inner in value.items():
            yield from variable_columns(f"{name}.{field}" if name else str(field), inner)
    elif isinstance(value, str):
        yield name, [value]
    elif isinstance(value, list | np.ndarray):
        array = np.asarray(value)
        if array.dtype.kind == "O":
            for place, inner in enumerate(array.ravel(), 1):
                yield from variable_columns(f"{name}({place})", inner)
        else:
            yield from _array_columns(name, array)
    elif np.isscalar(value):
        yield name, np.atleast_1d(np.asarray(value))


def _array_columns(name: str, array: NDArray[Any]) -> Iterator[tuple[str, Cells]]:
    """Columns of an array of numbers or texts; a wide one is taken as rows of columns."""
    if array.dtype.kind not in "biufUS" or array.ndim > 2 or not array.size:
        return
    plain = array.reshape(-1, 1) if array.ndim < 2 or 1 in array.shape else array
    for place in range(plain.shape[1]):
        column = plain[:, place]
        heading = name if plain.shape[1] == 1 else f"{name}(:,{place + 1})"
        yield heading, [str(each) for each in column] if column.dtype.kind in "US" else column


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
