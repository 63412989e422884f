"""TOML and JSON files read into typed structures; JSON files written."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from drftjax.common.errors import InputError, did_you_mean, read_failure

Structure = TypeVar("Structure", bound=msgspec.Struct)

_UNKNOWN = re.compile(r"unknown field `(?P<field>.+?)`")

_MISSING = re.compile(r"missing required field `(?P<field>.+?)`")

_PLACE = re.compile(r" - at `\$\.?(?P<place>.*?)`$")

HDF5 = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file."""

# Words for the types that msgspec names, in place of JSON's.
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table of entries",
    "null": "nothing",
    "date": "a date",
    "time": "a time of day",
    "datetime": "a date and time",
}

# Where a parser of TOML stopped, and what it says of an entry that is there already.
_STOPPED = re.compile(r"\(at line (?P<line>\d+), column (?P<column>\d+)\)")
_REPEATED = re.compile("twice|overwrite|immutable|mutate")

SHOWN_OF_LINE = 60
"""Most characters of a wrong line that an error message shows."""


def read_document(path: Path) -> dict[str, Any]:
    """Read a TOML or JSON file, by its suffix.

    Raises:
        InputError: names the file and why it cannot be read.
    """
    is_json = path.suffix.lower() == ".json"
    try:
        # Some editors put a byte-order mark first, which neither format knows.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as problem:
        raise InputError(f"{path}: {read_failure(path, problem)}") from None
    except UnicodeDecodeError as problem:
        kind = "JSON" if is_json else "TOML"
        why = f"is not text; must be {kind}"
        if problem.object.startswith(HDF5):
            why = (
                f"is an HDF5 file, must be {kind}; commands that take a run log in its place, such "
                "as simulate, have --like for it"
            )
        raise InputError(f"{path}: {why}") from None
    try:
        document = json.loads(text) if is_json else tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: its entries lie too deep in one another") from None
    except ValueError as problem:
        why = _syntax_failure(text, problem, "JSON" if is_json else "TOML")
        raise InputError(f"{path}: {why}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: must hold named entries, holds a {type(document).__name__}")
    return document


def _syntax_failure(text: str, problem: ValueError, kind: str) -> str:
    """Clause on text that is not TOML or not JSON, with the line where it stops to be."""
    if isinstance(problem, json.JSONDecodeError):
        line, column = problem.lineno, problem.colno
    elif (stopped := _STOPPED.search(str(problem))) is not None:
        line, column = int(stopped["line"]), int(stopped["column"])
    elif "digits" in str(problem):
        return "holds a number of too many digits"
    elif _REPEATED.search(str(problem)):
        return f"is not {kind}: its last line gives an entry that is there already"
    else:
        return f"is not {kind}: it ends inside an entry"
    lines = text.splitlines()
    shown = lines[line - 1].strip()[:SHOWN_OF_LINE] if line <= len(lines) else ""
    if not shown:
        return f"is not {kind}: it ends at line {line}, inside an entry"
    if _REPEATED.search(str(problem)):
        return f"is not {kind}: line {line}, {shown!r}, gives an entry that is there already"
    return f"is not {kind}: line {line}, {shown!r}, cannot be read from column {column} on"


def as_json(document: dict[str, Any]) -> bytes:
    """Encode plain values as JSON text; a number that is not finite becomes null."""
    return msgspec.json.format(msgspec.json.encode(document, enc_hook=float), indent=1) + b"\n"


def to_structure(document: dict[str, Any], kind: type[Structure], path: Path) -> Structure:
    """Convert a document to a structure; unknown, missing and mistyped entries are refused.

    Args:
        document: Entries of the file.
        kind: Type of the structure.
        path: The file, for the error message.

    Raises:
        InputError: names the file, the entry and, for an unknown one, the nearest known names.
    """
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as problem:
        # A structure that checks its own values says what must hold.
        refusal = problem.__cause__
        why = refusal if isinstance(refusal, InputError) else explain(str(problem), kind)
        raise InputError(f"{path}: {why}") from None


def explain(message: str, kind: type[msgspec.Struct]) -> str:
    """Rewrite msgspec's message on an invalid document in the terms of the file.

    Args:
        message: Text of msgspec's `ValidationError`.
        kind: Structure that the document should have.
    """
    place = match["place"] if (match := _PLACE.search(message)) else ""
    where = f" in [{place}]" if place else ""
    what = _PLACE.sub("", message)
    if unknown := _UNKNOWN.search(what):
        homes = _homes(kind)
        home = homes.pop(unknown["field"], None)
        hint = f"; it belongs in [{home}]" if home else did_you_mean(unknown["field"], homes)
        return f"unknown entry {unknown['field']!r}{where}{hint}"
    if missing := _MISSING.search(what):
        return f"the entry {missing['field']!r} is missing{where}"
    given = what.removeprefix("Invalid enum value ")
    if given != what and (allowed := _allowed(kind, place)):
        return f"{place} is {given}, must be one of {', '.join(map(repr, allowed))}"
    if "out of range" in what:
        return f"{place or 'the file'}: the number is larger than a computer holds"
    worded = re.sub(r"`(.+?)`", lambda types: _in_words(types[1]), what)
    return f"{place or 'the file'}: {worded[0].lower()}{worded[1:]}"


def _in_words(types: str) -> str:
    """Types that msgspec names, in words."""
    return " or ".join(_WORDS.get(each, each) for each in types.split(" | "))


def _allowed(kind: Any, place: str) -> tuple[Any, ...]:
    """Values that an entry may have, where it is a choice; () for other entries."""
    for name in place.split("."):
        known = {each.encode_name: each.type for each in msgspec.structs.fields(kind)}
        if name not in known:
            return ()
        kind = known[name]
        if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
            break
    return get_args(kind) if get_origin(kind) is Literal else ()


def _homes(kind: Any, place: str = "") -> dict[str, str]:
    """Table of each entry of a structure and of those inside it, by the entry's name.

    The table is "" for an entry of the outermost, and for one that several tables have.
    """
    homes: dict[str, str] = {}
    for field in msgspec.structs.fields(kind):
        inside: dict[str, str] = {field.encode_name: place}
        table = f"{place}.{field.encode_name}".lstrip(".")
        if get_origin(field.type) is list:
            table = f"[{table}]"
        for inner in (field.type, *get_args(field.type)):
            if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
                inside |= _homes(inner, table)
        for name, home in inside.items():
            homes[name] = home if homes.get(name, home) == home else ""
    return homes
