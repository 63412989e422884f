"""Which rows of a recording are committed, and what they are.

A recorder that is killed leaves the rows that it had flushed, and `/n_committed`: how many of
each group, written after them. What lies beyond may be half written.
"""

from typing import Any, Final, cast

import h5py
import numpy as np
from numpy.typing import NDArray

COMMITTED: Final = "n_committed"
GROUPS: Final = ("command", "measured", "online", "events")
"""The groups that /n_committed counts, in its order."""


def committed_rows(file: h5py.File) -> dict[str, int]:
    """Rows that are committed, by group.

    Raises:
        KeyError: The file is no recording.
    """
    counts = np.asarray(cast(h5py.Dataset, file[COMMITTED])[()])
    return {title: int(rows) for title, rows in zip(GROUPS, counts, strict=False) if title in file}


def committed_values(node: h5py.Dataset, rows: int) -> NDArray[Any]:
    """The first rows of a dataset.

    A kill can fall into the rewriting of the last chunk, so that its checksum fails. The rows
    that were committed before are the same in the old and in the new chunk.

    Raises:
        OSError: They cannot be read.
    """
    if node.shape[0] < rows:
        raise OSError(f"{node.shape[0]} rows of {rows} are there")
    try:
        return np.asarray(node[:rows])
    except OSError:
        side = cast(tuple[int, ...], node.chunks)[0]
        start = (rows - 1) // side * side
        _, chunk = node.id.read_direct_chunk((start,))
        last = np.frombuffer(chunk, node.dtype, rows - start)
        return np.concatenate([np.asarray(node[:start]), last])
