"""The run-log format: what stands where in the file, and what breaks it.

Everything here works on plain `Content`; the HDF5 library is on the other side of it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog import plausibility
from drftjax.runlog import validation as rules
from drftjax.runlog.content import (
    Attribute,
    Content,
    Dataset,
    Found,
    Group,
    Level,
    Violation,
    real_column,
)
from drftjax.runlog.header import OnlineHead
from drftjax.runlog.record import Events, Measured, Online, RecordedCommand, RecordedSetup, RunLog

SCHEMA: Final = "drft-run"


SCHEMA_VERSION: Final = 1


UNITS: Final[Mapping[str, Mapping[str, str]]] = {
    "command": {"time": "s", "omega": "rad/s", "vx": "m/s"},
    "measured": {"time": "s", "x": "m", "z": "m", "fx": "N", "fz": "N", "torque": "N m"},
    "online": {
        "time": "s",
        "zeta": "1",
        "x_sim": "m",
        "z_sim": "m",
        "vx_sim": "m/s",
        "fx_sim": "N",
        "fz_sim": "N",
        "tuned": "1",
        "late": "s",
        "age": "s",
        "flags": "1",
        "seq_sent": "1",
        "seq_received": "1",
        "rig_time": "s",
    },
    "events": {"event_time": "s", "code": "1", "arg": "1"},
}


AXES: Final = {"command": "time", "measured": "time", "online": "time", "events": "event_time"}


OPTIONAL: Final = {
    "command": frozenset({"vx"}),
    "measured": frozenset({"x", "z", "fx", "fz", "torque"}),
    "online": frozenset({"fz_sim"}),  # older programs did not record it
    "events": frozenset[str](),
}


MANDATORY_GROUPS: Final = ("command", "measured")


ONLINE_NUMBERS: Final = ("tick", "zeta_step", "tolerance")


TEXTS: Final = ("created", "run_id", "notes", "software", "software_version", "end_reason")


# Written by a recorder beside the format's own names.
BOOKKEEPING: Final = frozenset({"n_committed"})


SPELLINGS: Final = {
    **dict.fromkeys(("", "-", "dimensionless", "none"), "1"),
    **dict.fromkeys(("N*m", "N.m", "Nm", "N·m", "N-m"), "N m"),
    **dict.fromkeys(("rad s-1", "rad s^-1", "rad.s-1", "rad*s^-1"), "rad/s"),
    **dict.fromkeys(("m s-1", "m s^-1", "m.s-1", "m*s^-1"), "m/s"),
}


def identify(content: Content, schema: str, version: int) -> Iterator[Found]:
    """Whether the file says that it is of this schema, and of a version read here."""
    given = content.attributes.get("schema")
    if given is None:
        what = "a run log" if schema == SCHEMA else f"a {schema!r} file"
        yield "/", f"is not {what}: it has no attribute schema", Level.REFUSED
    elif given != schema:
        yield "/", f"is a {given!r} file, it must be a {schema!r} file", Level.REFUSED
    else:
        number = content.attributes.get("schema_version")
        if not isinstance(number, int | float) or not _is_whole(number) or number < 1:
            reason = f"has schema_version {number!r}, it must be {version}"
            yield "/", reason, Level.REFUSED
        elif number > version:
            reason = (
                f"has schema_version {number:g}, newer than {version}, the newest this "
                "program reads; update the program"
            )
            yield "/", reason, Level.REFUSED


def examine(content: Content) -> Iterator[Found]:
    """Every breach of the format by a file that `identify` accepts."""
    yield from _examine_root(content)
    yield from _examine_setup(content)
    for title in UNITS:
        group = content.groups.get(title)
        if group is not None:
            yield from _examine_group(title, group)
        elif title in MANDATORY_GROUPS:
            for name in sorted(UNITS[title].keys() - OPTIONAL[title]):
                yield f"/{title}/{name}", "is missing; a run log must have it", Level.REFUSED
    yield from _examine_meaning(content)
    for name in sorted(content.datasets.keys() - BOOKKEEPING):
        yield f"/{name}", "is a dataset outside the groups of a run log and is not read", Level.NOTE
    for title in sorted(content.groups.keys() - {*UNITS, "setup"}):
        hint = rules.nearest(title, (*UNITS, "setup"))
        yield f"/{title}", f"is no group of a run log and is not read; {hint}", Level.NOTE


def accepted(content: Content | None, violations: list[Violation]) -> Content:
    """The contents, or an InputError with the first reason to refuse them."""
    for each in violations:
        if each.level is Level.REFUSED:
            raise InputError(str(each))
    assert content is not None
    return content


def run_from(content: Content | None, violations: list[Violation]) -> RunLog:
    """The record of a surveyed file, or an InputError with the first reason against it."""
    return from_content(accepted(content, violations))


def from_content(content: Content) -> RunLog:
    """The record that an examined file holds."""
    values = {
        title: {name: each.values for name, each in group.datasets.items()}
        for title, group in content.groups.items()
    }

    def columns(title: str) -> dict[str, Any]:
        return {name: values[title][name] for name in UNITS[title] if name in values[title]}

    setup = content.groups.get("setup", Group()).attributes
    known: dict[str, Any] = {
        each.name: setup[each.name] for each in fields(RecordedSetup) if each.name in setup
    }
    online = events = None
    if "online" in content.groups:
        given = content.groups["online"].attributes
        numbers: dict[str, Any] = {name: given[name] for name in ONLINE_NUMBERS}
        bits = _meanings(content.groups["online"].datasets["flags"].attributes, "flag_masks")
        loop = _text(given.get("loop"))
        online = Online(**columns("online"), **numbers, loop=loop, meanings=bits)
    if "events" in content.groups:
        table = _meanings(content.groups["events"].datasets["code"].attributes)
        events = Events(**columns("events"), meanings=table)
    texts: dict[str, Any] = {name: _text(content.attributes.get(name)) for name in TEXTS}
    return RunLog(
        setup=RecordedSetup(**known),
        command=RecordedCommand(**columns("command")),
        measured=Measured(**columns("measured")),
        source=str(content.attributes["source"]),
        title=str(content.attributes["title"]),
        online=online,
        events=events,
        **texts,
    )


def to_content(run: RunLog) -> Content:
    """The file's contents for a record."""
    groups = {
        "setup": Group(attributes=run.setup.known()),
        "command": _columns("command", run.command),
        "measured": _columns("measured", run.measured),
    }
    if run.online is not None:
        columns = _columns("online", run.online).datasets
        bits = flag_table("flag_masks", run.online.meanings)
        groups["online"] = Group(_with(columns, "flags", bits), online_attributes(run.online))
    if run.events is not None:
        columns = _columns("events", run.events).datasets
        codes = flag_table("flag_values", run.events.meanings)
        groups["events"] = Group(_with(columns, "code", codes))
    attributes: dict[str, Attribute] = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "source": run.source,
        "title": run.title,
    }
    attributes |= {name: text for name in TEXTS if (text := getattr(run, name)) is not None}
    return Content(attributes, groups)


def online_attributes(online: Online | OnlineHead) -> dict[str, Attribute]:
    """The attributes of /online."""
    numbers: dict[str, Attribute] = {name: getattr(online, name) for name in ONLINE_NUMBERS}
    return numbers if online.loop is None else {**numbers, "loop": online.loop}


def flag_table(numbers: str, meanings: Mapping[int, str]) -> dict[str, Attribute]:
    """CF's flag table as attributes: flag_values or flag_masks, and a word for each."""
    if not meanings:
        return {}
    words = " ".join("_".join(each.split()) for each in meanings.values())
    return {numbers: list(meanings), "flag_meanings": words}


def same_unit(given: Attribute | None, wanted: str) -> bool:
    """Whether two spellings mean the same unit."""
    return SPELLINGS.get(str(given).strip(), str(given).strip()) == wanted


def _examine_root(content: Content) -> Iterator[Found]:
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
    setup = content.groups.get("setup")
    if setup is None:
        yield "/setup", "is missing; a run log has the group, empty if need be", Level.FORMAT
        return
    known = tuple(each.name for each in fields(RecordedSetup))
    for name, value in setup.attributes.items():
        if name not in known:
            hint = rules.nearest(name, known)
            yield "/setup", f"has {name}, which is not read; {hint}", Level.NOTE
        elif not isinstance(value, int | float):
            yield "/setup", f"has {name} = {value!r}, it must be a number", Level.REFUSED
        else:
            for reason in rules.setup_problems(name, value):
                yield "/setup", reason, Level.REFUSED


def _examine_group(title: str, group: Group) -> Iterator[Found]:
    units, axis = UNITS[title], AXES[title]
    for name in units:
        if name not in group.datasets and name not in OPTIONAL[title]:
            yield f"/{title}/{name}", "is missing; a run log must have it", Level.REFUSED
    if title == "measured" and not OPTIONAL[title] & group.datasets.keys():
        names = ", ".join(each for each in units if each in OPTIONAL[title])
        yield "/measured", f"has no channel; it must have one of {names}", Level.REFUSED
    if title == "online":
        yield from _examine_online_numbers(group)
    for name, dataset in group.datasets.items():
        where = f"/{title}/{name}"
        if name in BOOKKEEPING:
            continue
        if name not in units:
            hint = rules.nearest(name, tuple(units))
            yield where, f"is no channel of a run log and is not read; {hint}", Level.NOTE
            continue
        yield from _examine_storage(where, dataset, units[name], name == axis, f"/{title}/{axis}")
        yield from _examine_flags(where, dataset)
        yield from _examine_values(title, name, group)


def _examine_online_numbers(group: Group) -> Iterator[Found]:
    for name in ONLINE_NUMBERS:
        value = group.attributes.get(name)
        if not isinstance(value, int | float):
            found = "no attribute" if value is None else f"{value!r} as"
            yield "/online", f"has {found} {name}; it must be a number", Level.REFUSED
        elif not np.isfinite(value) or value < 0 or (name == "tick" and value == 0):
            yield "/online", f"has {name} = {value}, it must be finite, not negative", Level.REFUSED


def _examine_storage(
    where: str, dataset: Dataset, unit: str, is_axis: bool, axis: str
) -> Iterator[Found]:
    given = dataset.attributes.get("units")
    if given is None:
        yield where, f"has no attribute units; it is read as {unit!r}", Level.FORMAT
    elif not same_unit(given, unit):
        yield where, f"has units {given!r}, they must be {unit!r}", Level.REFUSED
    if not dataset.chunked:
        yield where, "is not chunked, so it can carry no checksum", Level.FORMAT
    elif not dataset.checksummed:
        yield where, "has no fletcher32 checksum, so damage to it goes unseen", Level.FORMAT
    if is_axis and not dataset.scale:
        yield where, "is not an HDF5 dimension scale", Level.FORMAT
    elif not is_axis and axis not in dataset.scaled_by:
        yield where, f"does not have {axis} as its dimension scale", Level.FORMAT


def _examine_flags(where: str, dataset: Dataset) -> Iterator[Found]:
    for name in ("flag_values", "flag_masks"):
        given = dataset.attributes.get(name, [])
        codes = given if isinstance(given, list) else [given]
        odd = next((code for code in codes if not _is_whole(code)), None)
        if odd is not None:
            yield where, f"has {odd!r} in {name}, it must hold whole numbers", Level.FORMAT


def _examine_values(title: str, name: str, group: Group) -> Iterator[Found]:
    dataset, axis = group.datasets[name], AXES[title]
    where = f"/{title}/{name}"
    values = real_column(dataset.values)
    time = group.datasets.get(axis)
    problems: list[str] = []
    if len(dataset.shape) != 1:
        yield where, f"has shape {dataset.shape}, it must be one column", Level.REFUSED
    elif name == axis and dataset.shape[0] == 0 and title != "events":
        yield where, "has no rows; a run has at least one", Level.REFUSED
    elif values is not None:
        if name == axis:
            problems += rules.axis_problems("it", values, repeats=title == "events")
        else:
            rows = time.shape[0] if time is not None and time.shape else values.size
            problems += rules.channel_problems("it", values, rows, f"/{title}/{axis}")
            if isinstance(whole := _whole(title, name), np.iinfo):
                problems += _integer_problems(values, whole)
    yield from ((where, f"cannot be used: {each}", Level.REFUSED) for each in problems)


def _examine_meaning(content: Content) -> Iterator[Found]:
    """Numbers that are allowed and cannot be meant."""
    given = content.groups.get("setup", Group()).attributes
    setup = {name: each for name, each in given.items() if isinstance(each, int | float)}
    for reason in plausibility.standing_problems(setup):
        yield "/setup/sinkage_static", reason, Level.FORMAT
    for title, name in plausibility.LARGEST:
        group = content.groups.get(title, Group())
        values = real_column(group.datasets[name].values) if name in group.datasets else None
        if values is None or not np.isfinite(values).all():
            continue
        where = f"/{title}/{name}"
        if name == "z":
            for reason in plausibility.height_problems(values, setup):
                yield where, reason, Level.FORMAT
        for reason in plausibility.unit_problems(title, name, values, setup):
            yield where, reason, Level.NOTE


def _whole(title: str, name: str) -> "np.iinfo[Any] | None":
    kinds = {"tuned": np.uint8, "flags": np.uint32, "seq_sent": np.uint32}
    kinds |= {"seq_received": np.uint32} if title == "online" else {"code": np.int32}
    return np.iinfo(kinds[name]) if name in kinds else None


def _integer_problems(values: NDArray[np.float64], kind: "np.iinfo[Any]") -> Iterator[str]:
    inside = (values == np.round(values)) & (values >= kind.min) & (values <= kind.max)
    if not inside.all():
        yield f"it must hold whole numbers from {kind.min} to {kind.max}"


def _columns(title: str, record: Any) -> Group:
    pairs = ((name, unit, getattr(record, name)) for name, unit in UNITS[title].items())
    return Group(
        {
            name: Dataset(values, values.shape, {"units": unit})
            for name, unit, values in pairs
            if values is not None
        }
    )


def _with(
    columns: Mapping[str, Dataset], name: str, attributes: Mapping[str, Attribute]
) -> dict[str, Dataset]:
    """The columns, one of them with more attributes."""
    one = columns[name]
    return {**columns, name: replace(one, attributes={**one.attributes, **attributes})}


def _meanings(attributes: Mapping[str, Attribute], numbers: str = "flag_values") -> dict[int, str]:
    """CF's flag table: numbers beside words, words apart by blanks; what is no number is left."""
    codes, words = attributes.get(numbers, []), attributes.get("flag_meanings", "")
    codes = codes if isinstance(codes, list) else [codes]
    words = words.split() if isinstance(words, str) else words
    words = words if isinstance(words, list) else [words]
    pairs = zip(codes, words, strict=False)
    return {int(code): str(word) for code, word in pairs if _is_whole(code)}


def _is_whole(value: Attribute | None) -> bool:
    return isinstance(value, int | float) and float(value).is_integer()


def _text(value: Attribute | None) -> str | None:
    return value if value is None or isinstance(value, str) else str(value)
