"""Violations of the run-log format, found in a file's contents as plain values."""

from collections.abc import Iterator
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog import plausibility
from drftjax.runlog import validation as rules
from drftjax.runlog.content import (
    Content,
    Dataset,
    Found,
    Group,
    Level,
    Violation,
    is_whole,
    real_column,
)
from drftjax.runlog.plausibility import PlausibilityLimits
from drftjax.runlog.record import CHANNELS
from drftjax.runlog.schema import (
    AXES,
    BOOKKEEPING,
    COLUMNS,
    MANDATORY_GROUPS,
    ONLINE_NUMBERS,
    SCHEMA,
    SETUP_UNITS,
    TEXTS,
    UNITS,
    Column,
    same_unit,
)

_MISSING: Final = "is missing; a run log must have it"


def identify(content: Content, schema: str, version: int) -> Iterator[Found]:
    """Reasons why a file is not of this schema, or of no version that is read here.

    Args:
        content: Root attributes at least.
        schema: Name that the attribute `schema` must have.
        version: Newest version that is read.
    """
    given = content.attributes.get("schema")
    if given is None:
        what = "a run log" if schema == SCHEMA else f"a {schema!r} file"
        yield "/", f"is not {what}: it has no attribute schema", Level.REFUSED
    elif given != schema:
        yield "/", f"is a {given!r} file, it must be a {schema!r} file", Level.REFUSED
    else:
        number = content.attributes.get("schema_version")
        if not isinstance(number, int | float) or not is_whole(number) or number < 1:
            reason = f"has schema_version {number!r}, it must be {version}"
            yield "/", reason, Level.REFUSED
        elif number > version:
            reason = (
                f"has schema_version {number:g}, newer than {version}, the newest this "
                "program reads; update the program"
            )
            yield "/", reason, Level.REFUSED


def examine(content: Content, limits: PlausibilityLimits = plausibility.LIMITS) -> Iterator[Found]:
    """Every violation of the run-log format.

    Args:
        content: Contents in which `identify` found nothing.
        limits: Largest numbers that a rig can have.
    """
    version = int(cast(float, content.attributes["schema_version"]))
    yield from _examine_root(content)
    yield from _examine_setup(content)
    for title, columns in COLUMNS.items():
        group = content.groups.get(title)
        if group is not None:
            yield from _examine_group(title, group, version)
        elif title in MANDATORY_GROUPS:
            names = sorted(each.name for each in columns if each.is_required(version))
            yield from ((f"/{title}/{name}", _MISSING, Level.REFUSED) for name in names)
    yield from _examine_plausibility(content, limits)
    for name in sorted(content.datasets.keys() - BOOKKEEPING):
        yield f"/{name}", "is a dataset outside the groups of a run log and is not read", Level.NOTE
    for title in sorted(content.groups.keys() - {*COLUMNS, "setup"}):
        hint = rules.nearest(title, (*COLUMNS, "setup"))
        yield f"/{title}", f"is no group of a run log and is not read; {hint}", Level.NOTE


def require_readable(content: Content | None, violations: list[Violation]) -> Content:
    """Return the contents of a surveyed file unless a violation forbids to read them.

    Raises:
        InputError: the first violation of level `REFUSED`.
    """
    for each in violations:
        if each.level is Level.REFUSED:
            raise InputError(str(each))
    assert content is not None
    return content


def _examine_root(content: Content) -> Iterator[Found]:
    """Violations in the attributes of the root."""
    attributes = content.attributes
    if attributes.get("complete") == 0:
        yield (
            "/",
            "is a recording that was not closed (complete = 0); repair it into an ordinary file",
            Level.REFUSED,
        )
    for name in ("source", "title"):
        if name not in attributes:
            yield "/", f"has no attribute {name}; a run log must have it", Level.REFUSED
        elif not isinstance(attributes[name], str):
            yield "/", f"has {name} = {attributes[name]!r}, it must be text", Level.REFUSED
    source = attributes.get("source")
    if isinstance(source, str):
        for reason in rules.source_problems(source):
            yield "/", reason, Level.REFUSED
    for name in TEXTS:
        if not isinstance(attributes.get(name, ""), str):
            yield "/", f"has {name} = {attributes[name]!r}, it must be text", Level.FORMAT


def _examine_setup(content: Content) -> Iterator[Found]:
    """Violations in the numbers of the set-up."""
    setup = content.groups.get("setup")
    if setup is None:
        yield "/setup", "is missing; a run log has the group, empty if need be", Level.FORMAT
        return
    known = tuple(SETUP_UNITS)
    for name, value in setup.attributes.items():
        if name not in known:
            hint = rules.nearest(name, known)
            yield "/setup", f"has {name}, which is not read; {hint}", Level.NOTE
        elif not isinstance(value, int | float):
            yield "/setup", f"has {name} = {value!r}, it must be a number", Level.REFUSED
        else:
            for reason in rules.setup_problems(name, value):
                yield "/setup", reason, Level.REFUSED


def _examine_group(title: str, group: Group, version: int) -> Iterator[Found]:
    """Violations in one group of columns."""
    columns = {each.name: each for each in COLUMNS[title]}
    for column in columns.values():
        if column.name not in group.datasets and column.is_required(version):
            yield f"/{title}/{column.name}", _MISSING, Level.REFUSED
    if title == "measured" and not set(CHANNELS) & group.datasets.keys():
        names = ", ".join(CHANNELS)
        yield "/measured", f"has no channel; it must have one of {names}", Level.REFUSED
    if title == "online":
        yield from _examine_online_numbers(group)
    for name, dataset in group.datasets.items():
        where = f"/{title}/{name}"
        if name in BOOKKEEPING:
            continue
        if name not in columns:
            hint = rules.nearest(name, tuple(columns))
            yield where, f"is no channel of a run log and is not read; {hint}", Level.NOTE
            continue
        yield from _examine_storage(title, columns[name], dataset)
        yield from _examine_flags(where, dataset)
        yield from _examine_values(title, columns[name], group)


def _examine_online_numbers(group: Group) -> Iterator[Found]:
    """Violations in the attributes of /online."""
    for name in ONLINE_NUMBERS:
        value = group.attributes.get(name)
        if not isinstance(value, int | float):
            found = "no attribute" if value is None else f"{value!r} as"
            yield "/online", f"has {found} {name}; it must be a number", Level.REFUSED
        elif not np.isfinite(value) or value < 0 or (name == "tick" and value == 0):
            yield "/online", f"has {name} = {value}, it must be finite, not negative", Level.REFUSED


def _examine_storage(title: str, column: Column, dataset: Dataset) -> Iterator[Found]:
    """Violations in the unit, chunks, checksum and dimension scale of a column."""
    where, unit, axis = f"/{title}/{column.name}", column.unit, AXES[title]
    given = dataset.attributes.get("units")
    if given is None:
        yield where, f"has no attribute units; it is read as {unit!r}", Level.FORMAT
    elif not same_unit(given, unit):
        yield where, f"has units {given!r}, they must be {unit!r}", Level.REFUSED
    if not dataset.chunked:
        yield where, "is not chunked, so it can carry no checksum", Level.FORMAT
    elif not dataset.checksummed:
        yield where, "has no fletcher32 checksum, so damage to it goes unseen", Level.FORMAT
    if column.name == axis and not dataset.scale:
        yield where, "is not an HDF5 dimension scale", Level.FORMAT
    elif column.name != axis and f"/{title}/{axis}" not in dataset.scaled_by:
        yield where, f"does not have /{title}/{axis} as its dimension scale", Level.FORMAT


def _examine_flags(where: str, dataset: Dataset) -> Iterator[Found]:
    """Violations in a flag table."""
    for name in ("flag_values", "flag_masks"):
        given = dataset.attributes.get(name, [])
        codes = given if isinstance(given, list) else [given]
        odd = next((code for code in codes if not is_whole(code)), None)
        if odd is not None:
            yield where, f"has {odd!r} in {name}, it must hold whole numbers", Level.FORMAT


def _examine_values(title: str, column: Column, group: Group) -> Iterator[Found]:
    """Violations in the values of a column."""
    dataset, axis = group.datasets[column.name], AXES[title]
    where, is_axis = f"/{title}/{column.name}", column.name == axis
    values = real_column(dataset.values)
    time = group.datasets.get(axis)
    problems: list[str] = []
    if len(dataset.shape) != 1:
        yield where, f"has shape {dataset.shape}, it must be one column", Level.REFUSED
    elif is_axis and dataset.shape[0] == 0 and title != "events":
        yield where, "has no rows; a run has at least one", Level.REFUSED
    elif values is not None and is_axis:
        problems += rules.axis_problems("it", values, repeats=title == "events")
    elif values is not None:
        rows = time.shape[0] if time is not None and time.shape else values.size
        problems += rules.channel_problems("it", values, rows, f"/{title}/{axis}")
        if column.integer is not None:
            problems += _integer_problems(values, column.integer)
    yield from ((where, f"cannot be used: {each}", Level.REFUSED) for each in problems)


def _examine_plausibility(content: Content, limits: PlausibilityLimits) -> Iterator[Found]:
    """Numbers that the format allows and a rig cannot have."""
    given = content.groups.get("setup", Group()).attributes
    setup = {name: each for name, each in given.items() if isinstance(each, int | float)}
    for reason in plausibility.standing_problems(setup, limits):
        yield "/setup/sinkage_static", reason, Level.FORMAT
    for title, name in plausibility.CHECKED_COLUMNS:
        group = content.groups.get(title, Group())
        values = real_column(group.datasets[name].values) if name in group.datasets else None
        if values is None or not np.isfinite(values).all():
            continue
        where = f"/{title}/{name}"
        if name == "z":
            for reason in plausibility.height_problems(values, setup, limits):
                yield where, reason, Level.FORMAT
        for reason in plausibility.unit_problems(title, name, values, setup, limits):
            yield where, reason, Level.NOTE
    for where, reason in plausibility.motion_problems(_sound_columns(content), setup, limits):
        yield where, reason, Level.NOTE


def _sound_columns(content: Content) -> dict[tuple[str, str], NDArray[np.float64]]:
    """Columns of /command and /measured; none where one of them cannot be used."""
    found: dict[tuple[str, str], NDArray[np.float64]] = {}
    for title in MANDATORY_GROUPS:
        datasets = content.groups.get(title, Group()).datasets
        for name in UNITS[title].keys() & datasets.keys():
            values = real_column(datasets[name].values)
            if values is None or values.ndim != 1 or not np.isfinite(values).all():
                return {}
            found[title, name] = values
        axis = found.get((title, AXES[title]), np.zeros(0))
        sizes = {values.size for (group, _), values in found.items() if group == title}
        if sizes != {axis.size} or not axis.size or (np.diff(axis) <= 0).any():
            return {}
    return found


def _integer_problems(values: NDArray[np.float64], kind: "np.iinfo[Any]") -> Iterator[str]:
    """Violation by values that an integer type cannot hold."""
    inside = (values == np.round(values)) & (values >= kind.min) & (values <= kind.max)
    if not inside.all():
        yield f"it must hold whole numbers from {kind.min} to {kind.max}"
