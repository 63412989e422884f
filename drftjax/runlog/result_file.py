"""A result file's contents: what a program found, beside the run logs it was found from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.content import Attribute, Content, Dataset, Group

FIT_SCHEMA: Final = "drft-fit"


@dataclass(frozen=True, eq=False)
class ResultGroup:
    """One group of a result file: datasets as (array, unit) by name, and attributes."""

    datasets: Mapping[str, tuple[ArrayLike, str]] = field(default_factory=dict)
    attributes: Mapping[str, Attribute] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return np.asarray(self.datasets[name][0])


@dataclass(frozen=True, eq=False)
class ResultFile:
    """A result file: root attributes and groups."""

    attributes: Mapping[str, Attribute]
    groups: Mapping[str, ResultGroup]

    def __getitem__(self, name: str) -> ResultGroup:
        return self.groups[name]


Columns = ResultGroup | Mapping[str, tuple[ArrayLike, str]]


"""A result's group, or just its datasets."""


def result_content(
    schema: str, version: int, attributes: Mapping[str, Attribute], groups: Mapping[str, Columns]
) -> Content:
    """The file's contents for a result."""
    stamped = {**attributes, "schema": schema, "schema_version": version}
    return Content(stamped, {title: _group(title, each) for title, each in groups.items()})


def result_from(content: Content) -> ResultFile:
    """The result that an examined file holds."""
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
    group = columns if isinstance(columns, ResultGroup) else ResultGroup(columns)
    datasets: dict[str, Dataset] = {}
    for name, (given, unit) in group.datasets.items():
        values = np.asarray(given)
        if values.dtype.kind not in "biuf":
            raise InputError(f"/{title}/{name} holds {values.dtype}, it must hold real numbers")
        values = values.astype(np.uint8) if values.dtype.kind == "b" else values
        datasets[name] = Dataset(values, values.shape, {"units": unit})
    return Group(datasets, group.attributes)
