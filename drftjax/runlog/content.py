"""A file's contents as plain values, between the HDF5 library and the meaning of a run log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Attribute = str | int | float | list[str] | list[int] | list[float]


class Level(StrEnum):
    """How far a finding goes."""

    REFUSED = "refused"  # no reader opens the file
    FORMAT = "format"  # readable, but not as the format says
    NOTE = "note"  # allowed, and perhaps not what was meant


Found = tuple[str, str, Level]


"""A finding before the file has a name: where, why, how far."""


@dataclass(frozen=True)
class Violation:
    """One thing that is wrong with one file.

    Attributes:
        path: The file.
        where: The object in the file, such as /measured/z; / for the file as a whole.
        reason: What was found and what must hold.
        level: Whether readers refuse the file for it.
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
    """One dataset: its values (None where they were not read) and how it is stored."""

    values: NDArray[Any] | None
    shape: tuple[int, ...] = ()
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    chunked: bool = True
    checksummed: bool = True
    scale: bool = False
    scaled_by: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Group:
    """One group's datasets and attributes by name."""

    datasets: Mapping[str, Dataset] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Content:
    """A whole file: root attributes and datasets, and one level of groups."""

    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    datasets: Mapping[str, Dataset] = field(default_factory=dict)


def real_column(values: NDArray[Any] | None) -> NDArray[np.float64] | None:
    """Values as float64, None where there are none."""
    return None if values is None else np.asarray(values, dtype=np.float64)


def is_whole(value: Attribute | None) -> bool:
    """Return whether an attribute is one whole number, of integer or real type."""
    return isinstance(value, int | float) and float(value).is_integer()
