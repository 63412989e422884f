"""MAT files of format 7.3, which are HDF5 files."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from drftjax.common.errors import InputError


def read_mat_variables(path: Path) -> dict[str, Any]:
    """Variables of a MAT 7.3 file by name; a struct is a mapping of its fields.

    Args:
        path: The file.

    Returns:
        Numbers as arrays in MATLAB's shape, texts as str; cells and objects are left out.

    Raises:
        InputError: the file cannot be read as HDF5.
    """
    try:
        with h5py.File(path, "r") as file:
            return _members(file)
    except (OSError, RuntimeError, ValueError, KeyError):
        raise InputError(f"{path}: is damaged, or no MAT file of format 7.3") from None


def _members(group: h5py.Group) -> dict[str, Any]:
    """Variables or fields of a group; names with # are MATLAB's own bookkeeping."""
    found: dict[str, Any] = {}
    for name in map(str, group):
        if name.startswith("#") or group.get(name, getlink=True).__class__ is not h5py.HardLink:
            continue
        member = group[name]
        if isinstance(member, h5py.Group):
            found[name] = _members(member)
        elif isinstance(member, h5py.Dataset) and member.attrs.get("MATLAB_empty", 0) == 0:
            kind = member.attrs.get("MATLAB_class", b"double")
            if kind == b"char":
                found[name] = "".join(map(chr, np.ravel(member[()].T)))
            elif member.dtype.kind in "biuf":
                found[name] = member[()].T  # MATLAB counts the other way
    return found
