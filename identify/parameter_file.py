"""Parameters of a fit as a TOML file."""

from pathlib import Path

import msgspec

from drftjax.errors import InputError
from drftjax.structfile import read_document, to_structure
from identify.parameter import Parameter, parameter


class Entry(msgspec.Struct, forbid_unknown_fields=True):
    """One [[parameter]]: a name, and what is known of it before the runs."""

    name: str
    shared: bool = False
    bounds: tuple[float, float] | None = None
    prior: tuple[float, float] | None = None
    start: float | None = None


class Entries(msgspec.Struct, forbid_unknown_fields=True):
    """The whole file."""

    parameter: list[Entry]


def read_parameters(path: Path) -> list[Parameter]:
    """The parameters that a file lists.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    entries = to_structure(read_document(path), Entries, path)
    if not entries.parameter:
        raise InputError(f"{path}: lists no [[parameter]]")
    try:
        return [parameter(**msgspec.structs.asdict(each)) for each in entries.parameter]
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
