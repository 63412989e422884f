"""Reading a TOML or JSON file into a typed structure, with errors that help."""

import json
import re
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from drftjax.errors import InputError

Structure = TypeVar("Structure", bound=msgspec.Struct)

_UNKNOWN = re.compile(r"unknown field `(?P<field>.+?)`")
_PLACE = re.compile(r" - at `(?P<place>.+?)`$")


def read_document(path: Path) -> dict[str, Any]:
    """The whole of a TOML or JSON file, by its ending.

    Raises:
        InputError: names the file and why it cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(f"{path}: cannot be read as text ({problem})") from None
    try:
        document = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError) as problem:
        kind = "JSON" if path.suffix == ".json" else "TOML"
        raise InputError(f"{path}: is not {kind} ({problem})") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: must hold named entries, holds a {type(document).__name__}")
    return document


def to_structure(document: dict[str, Any], kind: type[Structure], path: Path) -> Structure:
    """`document` as a `kind`; unknown, missing or mistyped entries are refused.

    Raises:
        InputError: names the file, the entry and, for an unknown one, the nearest known names.
    """
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as problem:
        raise InputError(f"{path}: {_explain(str(problem), kind)}") from None


def _explain(message: str, kind: type[msgspec.Struct]) -> str:
    place = _PLACE.search(message)
    where = f" in [{place['place'].removeprefix('$.')}]" if place else ""
    unknown = _UNKNOWN.search(message)
    if not unknown:
        return f"{_PLACE.sub('', message)}{where}"
    near = get_close_matches(unknown["field"], _names(kind), n=3, cutoff=0.5)
    hint = f"; did you mean {' or '.join(map(repr, near))}?" if near else ""
    return f"unknown entry {unknown['field']!r}{where}{hint}"


def _names(kind: Any) -> set[str]:
    """Names of every entry of a structure and of those inside it."""
    names: set[str] = set()
    for field in msgspec.structs.fields(kind):
        names.add(field.encode_name)
        inner = field.type
        if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
            names |= _names(inner)
    return names
