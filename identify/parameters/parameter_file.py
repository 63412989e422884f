"""Parameters of a fit as a TOML file."""

from pathlib import Path

import msgspec

from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document, to_structure
from identify.parameters.parameter import Parameter, parameter


class ParameterEntry(msgspec.Struct, forbid_unknown_fields=True):
    """One [[parameter]] of the file; fields as for `parameter`."""

    name: str
    shared: bool = False
    bounds: tuple[float, float] | None = None
    prior: tuple[float, float] | None = None
    start: float | None = None


class ParameterFile(msgspec.Struct, forbid_unknown_fields=True):
    """The whole file."""

    parameter: list[ParameterEntry]


def read_parameters(path: Path) -> list[Parameter]:
    """Return the parameters that a file lists.

    Raises:
        InputError: names the file, the entry and what must hold.
    """
    document = read_document(path)
    if not document.get("parameter"):
        raise InputError(f"{path}: holds no [[parameter]]; a fit's parameters are a list of them")
    entries = to_structure(document, ParameterFile, path)
    try:
        return [parameter(**msgspec.structs.asdict(each)) for each in entries.parameter]
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
