"""Contents of a file as the bytes of an HDF5 file.

The file is made in memory, because the HDF5 library itself does not survive a full disk.
"""

from collections.abc import Mapping
from typing import Any, Final, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.content import Attribute, Content, Dataset

ROWS_IN_CHUNK: Final = 16384


def image(content: Content, axes: Mapping[str, str]) -> bytes:
    """Bytes of an HDF5 file of format 1.10, whose metadata carry checksums.

    Args:
        content: Contents of the file.
        axes: Name of the dimension scale by group.
    """
    with h5py.File(
        "image", "w", driver="core", backing_store=False, libver=("v110", "v110")
    ) as file:
        put_attributes(file, content.attributes)
        for title, group in content.groups.items():
            node = file.create_group(title)
            put_attributes(node, group.attributes)
            for name, dataset in group.datasets.items():
                _put_dataset(node, name, dataset)
            if title in axes:
                scale_rows(node, axes[title])
        file.flush()
        return file.id.get_file_image()


def _put_dataset(node: h5py.Group, name: str, dataset: Dataset) -> None:
    """Write one dataset in checksummed chunks."""
    values = np.atleast_1d(cast(NDArray[Any], dataset.values))
    rows = max(1, min(values.shape[0], ROWS_IN_CHUNK))
    # Little-endian by name, so that a file does not depend on the machine that wrote it.
    made = node.create_dataset(
        name,
        data=values.astype(values.dtype.newbyteorder("<")),
        chunks=(rows, *(max(1, extent) for extent in values.shape[1:])),
        shuffle=True,
        compression="gzip",
        fletcher32=True,
    )
    put_attributes(made, dataset.attributes)


def put_attributes(node: Any, attributes: Mapping[str, Attribute]) -> None:
    """Write attributes on a group, dataset or file."""
    for name, value in attributes.items():
        if isinstance(value, list) and value and isinstance(value[0], str):
            node.attrs.create(name, value, dtype=h5py.string_dtype())
        else:
            node.attrs[name] = value


def scale_rows(node: h5py.Group, axis: str) -> None:
    """Make one dataset of a group the dimension scale of the others."""
    scale = cast(h5py.Dataset, node[axis])
    scale.make_scale(axis)
    for name, each in node.items():
        if name != axis:
            each.dims[0].attach_scale(scale)
