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
}


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
    except (ValueError, RecursionError) as problem:
        kind = "JSON" if is_json else "TOML"
        raise InputError(f"{path}: is not {kind} ({problem})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: must hold named entries, holds a {type(document).__name__}")
    return document


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
        hint = did_you_mean(unknown["field"], sorted(_names(kind)))
        return f"unknown entry {unknown['field']!r}{where}{hint}"
    if missing := _MISSING.search(what):
        return f"the entry {missing['field']!r} is missing{where}"
    given = what.removeprefix("Invalid enum value ")
    if given != what and (allowed := _allowed(kind, place)):
        return f"{place} is {given}, must be one of {', '.join(map(repr, allowed))}"
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


def _names(kind: Any) -> set[str]:
    """Names of all entries of a structure and of the structures inside it."""
    names: set[str] = set()
    for field in msgspec.structs.fields(kind):
        names.add(field.encode_name)
        for inner in (field.type, *get_args(field.type)):
            if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
                names |= _names(inner)
    return names
