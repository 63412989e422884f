"""Runs as the bytes of files of other programs, by suffix."""

import json
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.export.channels import Channels, groups_of, one_table
from drftjax.runlog.importers.readers.packages import required_package
from drftjax.runlog.record import RunLog
from drftjax.runlog.schema import AXES

_DIGITS: Final = ".12g"
"""Format of a number in text, of more digits than any instrument has."""


def csv_bytes(table: Channels, separator: str = ",") -> bytes:
    """Table of text, headings with units; an empty cell where a value is not known."""
    names = [f"{name} [{each.unit}]" for name, each in table.items()]
    rows = zip(*(each.values.tolist() for each in table.values()), strict=True)
    lines = (separator.join("" if v != v else format(v, _DIGITS) for v in row) for row in rows)
    return ("\n".join([separator.join(names), *lines]) + "\n").encode()


def parquet_bytes(path: Path, table: Channels) -> bytes:
    """Parquet file with the unit of each column in the metadata of its field."""
    pyarrow = required_package("pyarrow", "pyarrow", path, "writing")
    parquet = required_package("pyarrow.parquet", "pyarrow", path, "writing")
    kinds = {name: pyarrow.from_numpy_dtype(each.values.dtype) for name, each in table.items()}
    fields = [
        pyarrow.field(name, kinds[name], metadata={"unit": each.unit})
        for name, each in table.items()
    ]
    columns = [pyarrow.array(each.values) for each in table.values()]
    sink = BytesIO()
    parquet.write_table(pyarrow.table(columns, schema=pyarrow.schema(fields)), sink)
    return sink.getvalue()


def mat_bytes(run: RunLog, groups: Mapping[str, Channels]) -> bytes:
    """MAT file of format 5 with one struct `run`: a struct for each group, `setup` and `units`."""
    from scipy.io import savemat

    content: dict[str, Any] = {"title": run.title, "source": run.source, "setup": run.setup.known()}
    content |= {
        title: {name: each.values for name, each in columns.items()}
        for title, columns in groups.items()
    }
    content["units"] = {
        title: {name: each.unit for name, each in columns.items()}
        for title, columns in groups.items()
    }
    sink = BytesIO()
    savemat(sink, {"run": content}, oned_as="column", do_compression=True)
    return sink.getvalue()


def netcdf_bytes(run: RunLog, groups: Mapping[str, Channels]) -> bytes:
    """Classic netCDF file: a dimension `GROUP_time` and variables `GROUP_NAME` for each group."""
    from scipy.io import netcdf_file

    sink = BytesIO()
    file = netcdf_file(sink, "w", version=2)
    file.title = run.title.encode()
    file.source = run.source.encode()
    for name, value in run.setup.known().items():
        setattr(file, name, np.float64(value))
    for title, columns in groups.items():
        axis = f"{title}_{AXES.get(title, 'time')}"
        file.createDimension(axis, len(next(iter(columns.values())).values))
        for name, each in columns.items():
            # The classic format has no whole numbers without a sign.
            variable = file.createVariable(f"{title}_{name}", "d", (axis,))
            variable[:] = each.values.astype(np.float64)
            variable.units = each.unit.encode()
    file.flush()
    return sink.getvalue()


def mcap_bytes(path: Path, run: RunLog, groups: Mapping[str, Channels]) -> bytes:
    """MCAP file with a topic of JSON messages for each group.

    Times are those since 1970 where the run says when it began, else from the run's start.
    """
    writing = required_package("mcap.writer", "mcap", path, "writing")
    sink = BytesIO()
    writer = writing.Writer(sink)
    writer.start(profile="", library="drftjax")
    zero = _began(run)
    messages: list[tuple[int, int, bytes]] = []
    for title, columns in groups.items():
        schema = writer.register_schema(title, "jsonschema", json.dumps(_schema(columns)).encode())
        channel = writer.register_channel(f"/{title}", "json", schema)
        for time, data in _messages(columns, AXES.get(title, "time")):
            messages.append((zero + round(time * 1e9), channel, data))
    for number, (stamp, channel, data) in enumerate(sorted(messages)):
        writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp, sequence=number)
    writer.finish()
    return sink.getvalue()


def _schema(columns: Channels) -> dict[str, Any]:
    """JSON schema of a group's messages."""
    fields = {name: {"type": "number", "description": each.unit} for name, each in columns.items()}
    return {"type": "object", "properties": fields}


def _messages(columns: Channels, axis: str) -> Iterator[tuple[float, bytes]]:
    """Time [s] and JSON of each row; a value that is not known is left out."""
    names = tuple(columns)
    for row in zip(*(each.values.tolist() for each in columns.values()), strict=True):
        fields = {name: value for name, value in zip(names, row, strict=True) if value == value}
        yield float(fields[axis]), json.dumps(fields).encode()


def _began(run: RunLog) -> int:
    """Nanoseconds since 1970 at the run's start; 0 where it does not say."""
    try:
        moment = datetime.fromisoformat(run.created or "")
    except ValueError:
        return 0
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return round(moment.timestamp() * 1e6) * 1000


TABLES: Final[Mapping[str, Callable[[Path, Channels], bytes]]] = {
    ".csv": lambda _, table: csv_bytes(table),
    ".tsv": lambda _, table: csv_bytes(table, "\t"),
    ".parquet": parquet_bytes,
}
"""Formats that hold one table a file."""

WHOLE_RUNS: Final[Mapping[str, Callable[[Path, RunLog, Mapping[str, Channels]], bytes]]] = {
    ".mat": lambda _, run, groups: mat_bytes(run, groups),
    ".nc": lambda _, run, groups: netcdf_bytes(run, groups),
    ".mcap": mcap_bytes,
}
"""Formats that hold all groups in one file."""


def exported_files(
    run: RunLog, path: Path, *, groups: bool = False, derived: bool = False
) -> dict[Path, bytes]:
    """Contents of the files that a run is exported to.

    Args:
        run: The run.
        path: Name of the file; its suffix chooses the format.
        groups: True for a table for each group, each at its own times, in files NAME_GROUP.
        derived: True to add the derived channels.

    Raises:
        InputError: the suffix is unknown, a package is missing, or nothing can be derived.
    """
    suffix = path.suffix.lower()
    if suffix in WHOLE_RUNS:
        if groups:
            raise InputError(f"{path}: {suffix} holds all groups in one file; leave out --groups")
        return {path: WHOLE_RUNS[suffix](path, run, groups_of(run, derived))}
    if suffix not in TABLES:
        known = ", ".join((*TABLES, *WHOLE_RUNS))
        raise InputError(f"{path}: the name of an exported file must end in one of {known}")
    if not groups:
        return {path: TABLES[suffix](path, one_table(run, derived))}
    return {
        path.with_name(f"{path.stem}_{title}{path.suffix}"): TABLES[suffix](path, columns)
        for title, columns in groups_of(run, derived).items()
    }
