"""Contents of an HDF5 file as plain values, and violations found in them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Attribute = str | int | float | list[str] | list[int] | list[float]


class Level(StrEnum):
    """Severity of a violation."""

    REFUSED = "refused"  # the file is not read
    FORMAT = "format"  # the file is read, but is not as the format says
    NOTE = "note"  # allowed, and perhaps a mistake


Found = tuple[str, str, Level]
"""Violation without the name of its file: place, reason and level."""


@dataclass(frozen=True)
class Violation:
    """Violation of the format by one file.

    Attributes:
        path: Name of the file.
        where: Object in the file, such as /measured/z; / for the file as a whole.
        reason: Clause with what was found and what must hold.
        level: Severity.
    """

    path: str
    where: str
    reason: str
    level: Level = Level.REFUSED

    def __str__(self) -> str:
        place = "" if self.where == "/" else f"{self.where} "
        return f"{self.path}: {place}{self.reason}"


@dataclass(frozen=True, eq=False)
class Dataset:
    """One dataset and its storage.

    Attributes:
        values: Its values; None where they were not read.
        shape: Shape in the file.
        attributes: Attributes by name.
        chunked: True where it is stored in chunks.
        checksummed: True where its chunks carry a fletcher32 checksum.
        scale: True where it is an HDF5 dimension scale.
        scaled_by: Paths of the dimension scales of its rows.
    """

    values: NDArray[Any] | None
    shape: tuple[int, ...] = ()
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    chunked: bool = True
    checksummed: bool = True
    scale: bool = False
    scaled_by: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Group:
    """Datasets and attributes of one group, by name."""

    datasets: Mapping[str, Dataset] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Content:
    """Contents of a file: attributes and datasets of the root, and groups by their path."""

    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    datasets: Mapping[str, Dataset] = field(default_factory=dict)


def real_column(values: NDArray[Any] | None) -> NDArray[np.float64] | None:
    """Convert the values of a dataset to float64; None where they were not read."""
    return None if values is None else np.asarray(values, dtype=np.float64)


def is_whole(value: Attribute | None) -> bool:
    """Return whether an attribute is one whole number, of integer or real type."""
    return isinstance(value, int | float) and float(value).is_integer()
