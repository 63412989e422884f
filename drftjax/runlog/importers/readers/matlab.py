"""MAT files: format 5 by scipy, format 7.3, which is HDF5, by this project's door to it."""

import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from drftjax.common.child_process import program
from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.matlab import read_mat_variables
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.packages import unreadable
from drftjax.runlog.importers.table import Cells, Table, named_tables

TIME_LIMIT: Final = 120.0
"""Time that one file may take [s]; one of 100 MB takes one."""

_READ: Final = program("drftjax.runlog.importers.readers.matlab", "print_columns")


def read_mat(path: Path, layout: Layout) -> list[Table]:
    """Read the variables of a MAT file; vectors of one length are a table.

    Fields of a struct are named with a dot, columns of a matrix with their number, as MATLAB writes
    them: `log.t`, `log.force(:,2)`. Objects (timeseries, table) are skipped.

    Args:
        path: The file.
        layout: Not used: a MAT file has no lines.

    Raises:
        InputError: the file cannot be read, or has no vector.
    """
    del layout
    columns = _columns_by_child(path)
    lengths: dict[int, dict[str, Cells]] = {}
    for name, cells in columns.items():
        lengths.setdefault(len(cells), {})[name] = cells
    if not any(length > 1 for length in lengths):
        raise InputError(
            f"{path}: has no vector of numbers; a timeseries or table is saved as arrays by "
            "t = ts.Time; z = ts.Data; save('run.mat', 't', 'z')"
        )
    ordered = sorted(lengths, reverse=True)
    return [
        table
        for length in ordered
        for table in named_tables(path, {"": lengths[length]}, "element")
    ]


def _columns_by_child(path: Path) -> dict[str, Cells]:
    """Columns of a MAT file, read in a child process: a damaged one can crash either library."""
    command = [sys.executable, "-I", "-c", _READ, str(path)]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIME_LIMIT
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: could not be read in {TIME_LIMIT:g} s; is it damaged?") from None
    if done.returncode:
        raise InputError(f"{path}: cannot be read as a MAT file; it is damaged")
    reason, packed = msgspec.msgpack.decode(done.stdout)
    if reason:
        raise InputError(reason)
    return {
        name: np.frombuffer(values, np.dtype(kind)) if kind else values
        for name, kind, values in packed
    }


def print_columns() -> None:
    """Write the columns of the MAT file named by the first argument to stdout, packed."""
    path = Path(sys.argv[1])
    try:
        columns = dict(variable_columns("", _variables(path)))
        answer = "", [(name, *_packed(cells)) for name, cells in columns.items()]
    except InputError as error:
        answer = str(error), []
    sys.stdout.buffer.write(msgspec.msgpack.encode(answer))


def _packed(cells: Cells) -> tuple[str, bytes | list[str]]:
    """Type and bytes of numbers; no type and the cells of text."""
    if isinstance(cells, np.ndarray):
        return cells.dtype.str, np.ascontiguousarray(cells).tobytes()
    return "", list(cells)


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


def _variables(path: Path) -> dict[str, Any]:
    """Variables of a MAT file by name, those of the format itself left out."""
    from scipy.io import loadmat

    try:
        with path.open("rb") as file:
            start = file.read(128)
        if b"MATLAB 7.3" in start or start.startswith(b"\x89HDF"):
            return read_mat_variables(path)
        found = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except Exception as error:
        raise unreadable(path, "a MAT file", error) from None
    own = {name: each for name, each in found.items() if not name.startswith("__")}
    return {name: each for name, each in own.items() if not _is_object(each)}


def _is_object(value: Any) -> bool:
    """True of an object of MATLAB's, whose contents the format does not describe."""
    return isinstance(value, np.ndarray) and value.dtype.names is not None
