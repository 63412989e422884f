"""HDF5 files of results beside run logs, such as those of a fit."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.content import Attribute, Content, Dataset, Group

FIT_SCHEMA: Final = "drft-fit"
POSTERIOR_SCHEMA: Final = "drft-posterior"


@dataclass(frozen=True, eq=False)
class ResultGroup:
    """One group of a result file: datasets as (array, unit) by name, and attributes.

    `group[name]` is the array of a dataset.
    """

    datasets: Mapping[str, tuple[ArrayLike, str]] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.asarray(self.datasets[name][0])


@dataclass(frozen=True, eq=False)
class ResultFile:
    """Result file: attributes of the root, and groups by name (`file[name]`)."""

    attributes: Mapping[str, Attribute]
    groups: Mapping[str, ResultGroup]

    def __getitem__(self, name: str) -> ResultGroup:
        return self.groups[name]


Columns = ResultGroup | Mapping[str, tuple[ArrayLike, str]]
"""Group of a result, or only its datasets."""


def result_content(
    schema: str, version: int, attributes: Mapping[str, Attribute], groups: Mapping[str, Columns]
) -> Content:
    """Contents of the file that holds a result.

    Args:
        schema: Name of the kind of file.
        version: Version of that schema.
        attributes: Attributes of the root.
        groups: Groups by name; arrays of real numbers of any rank.

    Raises:
        InputError: a dataset does not hold real numbers.
    """
    stamped = {**attributes, "schema": schema, "schema_version": version}
    return Content(stamped, {title: _group(title, each) for title, each in groups.items()})


def result_from(content: Content) -> ResultFile:
    """Result that a surveyed file holds."""
    groups = {
        title: ResultGroup(
            {
                name: (cast(NDArray[Any], each.values), str(each.attributes.get("units", "1")))
                for name, each in group.datasets.items()
            },
            group.attributes,
        )
        for title, group in content.groups.items()
    }
    return ResultFile(content.attributes, groups)


def _group(title: str, columns: Columns) -> Group:
    """Group of a file for a group of a result; truth values become 0 and 1."""
    group = columns if isinstance(columns, ResultGroup) else ResultGroup(columns)
    datasets: dict[str, Dataset] = {}
    for name, (given, unit) in group.datasets.items():
        values = np.asarray(given)
        if values.dtype.kind not in "biuf":
            raise InputError(f"/{title}/{name} holds {values.dtype}, it must hold real numbers")
        values = values.astype(np.uint8) if values.dtype.kind == "b" else values
        datasets[name] = Dataset(values, values.shape, {"units": unit})
    return Group(datasets, group.attributes)
