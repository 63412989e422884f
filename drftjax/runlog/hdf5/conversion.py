"""Conversion between run logs and the contents of their files."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drftjax.runlog.content import Attribute, Content, Dataset, Group, Violation, is_whole
from drftjax.runlog.hdf5.examination import require_readable
from drftjax.runlog.header import OnlineHead
from drftjax.runlog.record import Events, Measured, Online, RecordedCommand, RecordedSetup, RunLog
from drftjax.runlog.schema import (
    ONLINE_NUMBERS,
    SCHEMA,
    SCHEMA_VERSION,
    SETUP_UNITS,
    TEXTS,
    UNITS,
)


def run_from_survey(content: Content | None, violations: list[Violation]) -> RunLog:
    """Run log of a surveyed file.

    Raises:
        InputError: the first reason to refuse the file.
    """
    return from_content(require_readable(content, violations))


def from_content(content: Content) -> RunLog:
    """Run log that an examined file holds."""

    def columns(title: str) -> dict[str, Any]:
        """Values of the columns that a group has, by name."""
        datasets = content.groups[title].datasets
        return {name: datasets[name].values for name in UNITS[title] if name in datasets}

    setup = content.groups.get("setup", Group()).attributes
    known: dict[str, Any] = {name: setup[name] for name in SETUP_UNITS if name in setup}
    online = events = None
    if "online" in content.groups:
        group = content.groups["online"]
        numbers: dict[str, Any] = {name: group.attributes[name] for name in ONLINE_NUMBERS}
        bits = _meanings(group.datasets["flags"].attributes, "flag_masks")
        loop = _text(group.attributes.get("loop"))
        online = Online(**columns("online"), **numbers, loop=loop, meanings=bits)
    if "events" in content.groups:
        table = _meanings(content.groups["events"].datasets["code"].attributes, "flag_values")
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
    """Contents of the file that holds a run log."""
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
    """Attributes of /online."""
    numbers: dict[str, Attribute] = {name: getattr(online, name) for name in ONLINE_NUMBERS}
    return numbers if online.loop is None else {**numbers, "loop": online.loop}


def flag_table(numbers: str, meanings: Mapping[int, str]) -> dict[str, Attribute]:
    """Flag table of the CF conventions, as attributes.

    Args:
        numbers: "flag_values" for codes, "flag_masks" for bits.
        meanings: Words by number.
    """
    if not meanings:
        return {}
    words = " ".join("_".join(each.split()) for each in meanings.values())
    return {numbers: list(meanings), "flag_meanings": words}


def _columns(title: str, record: Any) -> Group:
    """Datasets of a record, with their units."""
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
    """Columns of which one gets further attributes."""
    one = columns[name]
    return {**columns, name: replace(one, attributes={**one.attributes, **attributes})}


def _meanings(attributes: Mapping[str, Attribute], numbers: str) -> dict[int, str]:
    """Words by number of a CF flag table; entries that are not whole numbers are skipped."""
    codes, words = attributes.get(numbers, []), attributes.get("flag_meanings", "")
    codes = codes if isinstance(codes, list) else [codes]
    words = words.split() if isinstance(words, str) else words
    words = words if isinstance(words, list) else [words]
    pairs = zip(codes, words, strict=False)
    return {int(code): str(word) for code, word in pairs if is_whole(code)}


def _text(value: Attribute | None) -> str | None:
    """Attribute as text; None where it is absent."""
    return value if value is None or isinstance(value, str) else str(value)
