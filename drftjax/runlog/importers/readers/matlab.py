"""MAT files: format 5 by scipy, format 7.3, which is HDF5, by this project's door to it."""

from pathlib import Path
from typing import Any

import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.matlab import read_mat_variables
from drftjax.runlog.importers.layout import Layout
from drftjax.runlog.importers.readers.nested import variable_columns
from drftjax.runlog.importers.readers.packages import unreadable
from drftjax.runlog.importers.table import Cells, Table, named_tables


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
    columns = dict(variable_columns("", _variables(path)))
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
