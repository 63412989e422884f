"""Parquet files, read by pyarrow."""

from pathlib import Path
from typing import Any

import numpy as np

from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.packages import required_package, unreadable
from drftjax.runlog.importers.table import Cells, Table, named_tables


def read_parquet(path: Path, layout: Layout) -> list[Table]:
    """Read the columns of a Parquet file; nested ones are skipped.

    Times since 1970 come in nanoseconds. The metadata `unit` or `units` of a field is its unit.

    Args:
        path: The file.
        layout: Not used: a Parquet file has no lines.

    Raises:
        InputError: the file cannot be read.
    """
    del layout
    parquet = required_package("pyarrow.parquet", "pyarrow", path)
    try:
        table = parquet.ParquetFile(path).read()
    except Exception as error:
        raise unreadable(path, "a Parquet file", error) from None
    columns: dict[str, Cells] = {}
    units: dict[str, str] = {}
    for field, column in zip(table.schema, table.columns, strict=True):
        cells = _cells(field.type, column)
        if cells is None:
            continue
        columns[field.name] = cells
        metadata = {key.lower(): value for key, value in (field.metadata or {}).items()}
        given = metadata.get(b"unit", metadata.get(b"units"))
        if given is not None:
            units[field.name] = given.decode("utf-8", "replace")
        elif _is_time(field.type):
            units[field.name] = "iso8601" if isinstance(cells, list) else "ns"
    return named_tables(path, {"": columns}, "row", units=units)


def _is_time(kind: Any) -> bool:
    """True of times since 1970 and of spans of time."""
    from pyarrow import types

    return types.is_timestamp(kind) or types.is_duration(kind)


def _cells(kind: Any, column: Any) -> Cells | None:
    """Cells of a column; None of one that holds neither numbers, times nor text."""
    import pyarrow
    from pyarrow import types

    if _is_time(kind):
        ticks = column.cast(
            pyarrow.timestamp("ns") if types.is_timestamp(kind) else pyarrow.duration("ns"),
            safe=False,
        )
        if not column.null_count:
            return np.asarray(ticks.cast(pyarrow.int64()).to_numpy())
        return [
            "" if each is None else str(each) for each in ticks.cast(pyarrow.string()).to_pylist()
        ]
    if types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy())
    if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind):
        return np.asarray(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
    if types.is_decimal(kind):
        return np.asarray(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
    if types.is_dictionary(kind):
        column = column.cast(kind.value_type)
        kind = kind.value_type
    if types.is_string(kind) or types.is_large_string(kind):
        return ["" if each is None else each for each in column.to_pylist()]
    return None
