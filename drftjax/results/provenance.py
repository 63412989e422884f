"""Provenance of a result: its inputs, its command line, and the software and machine behind it."""

import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

import drftjax
from drftjax.common.errors import InputError
from drftjax.common.structured_files import read_document, to_structure
from drftjax.runlog.files import digest_of, run_files

PACKAGES: Final = ("jax", "numpy", "scipy", "equinox", "optimistix")
"""Packages whose versions can move a number of a result."""


class InputFile(msgspec.Struct, frozen=True):
    """File that a result was made from.

    Attributes:
        name: Its path, as on the command line; of a folder, that and the file's name.
        sha256: SHA-256 of its contents; None where it could not be read.
    """

    name: str
    sha256: str | None = None


class Machine(msgspec.Struct, frozen=True):
    """Machine and set-up of JAX.

    Attributes:
        system: Operating system and processor, such as "Linux x86_64".
        precision: "float64" or "float32".
        backend: "cpu" or another of JAX's.
        devices: Number of JAX's devices; on them as many runs are simulated at once.
        threads: Number of the processor's threads.
    """

    system: str
    precision: str
    backend: str
    devices: int
    threads: int | None


class Provenance(msgspec.Struct, frozen=True):
    """Origin of a result.

    Attributes:
        inputs: Files that it was made from.
        command: Arguments of `drft`, the subcommand first; None where Python called the library.
        versions: Of Python, this project and `PACKAGES`, by name.
        machine: Machine and set-up of JAX.
        seed: Of its random draws; None where nothing is drawn.
        date: UTC, ISO 8601.
    """

    inputs: tuple[InputFile, ...]
    command: tuple[str, ...] | None
    versions: dict[str, str]
    machine: Machine
    seed: int | None
    date: str

    def document(self) -> dict[str, Any]:
        """Plain values, in the layout of a result's JSON file."""
        return msgspec.to_builtins(self)


class ResultDocument(msgspec.Struct):
    """Any result's JSON file, as far as its origin goes.

    Attributes:
        schema: Kind of the result.
        provenance: Its origin; None in files of before there was one.
    """

    schema: str
    provenance: Provenance | None = None


def read_result_document(path: Path) -> tuple[dict[str, Any], ResultDocument]:
    """Read a result's JSON file: all of it as plain values, and its kind and origin.

    Raises:
        InputError: names the file, and why it is no result.
    """
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: a result's file must end in .json")
    plain = read_document(path)
    if not isinstance(plain.get("schema"), str):
        raise InputError(f"{path}: names no schema, as the JSON file of every result of drft does")
    return plain, to_structure(plain, ResultDocument, path)


def command_provenance(
    subcommand: str, inputs: Iterable[Path | None], seed: int | None = None
) -> Provenance:
    """Provenance of a result that this program's command line makes.

    Args:
        subcommand: Its name, as after `drft`.
        inputs: Files and folders that it was given; None for an option that was not.
        seed: Of its random draws.
    """
    arguments = sys.argv[1:]
    if arguments[:1] != [subcommand]:  # a module that was run by itself
        arguments = [subcommand, *arguments]
    return _provenance([each for each in inputs if each], arguments, seed)


def library_provenance(given: object, seed: int | None = None) -> Provenance:
    """Provenance of a result that a call from Python makes.

    Args:
        given: Runs, as `drftjax.fit` takes them; those that are no files leave no trace.
        seed: Of its random draws.
    """
    several = [given] if isinstance(given, str | Path) else given
    several = several.values() if isinstance(several, Mapping) else several
    listed = several if isinstance(several, Iterable) else ()
    return _provenance([Path(each) for each in listed if isinstance(each, str | Path)], None, seed)


def _provenance(
    inputs: Sequence[Path], arguments: Sequence[str] | None, seed: int | None
) -> Provenance:
    return Provenance(
        inputs=tuple(InputFile(*each) for each in input_digests(inputs).items()),
        command=None if arguments is None else tuple(map(encodable, arguments)),
        versions=software_versions(),
        machine=_machine(),
        seed=seed,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def input_digests(inputs: Iterable[Path], base: Path = Path()) -> dict[str, str | None]:
    """SHA-256 of files by their names; None for what cannot be read.

    Args:
        inputs: Files, and folders of run logs.
        base: Folder in which relative paths are looked up; the names do not hold it.
    """
    digests = {}
    for path in inputs:
        place = base / path
        if place.is_dir():
            files = []
            with suppress(InputError):  # reading it gives the reason
                files = run_files([place])
            digests |= {encodable(str(path / each.name)): digest_of(each) for each in files}
        else:
            digests[encodable(str(path))] = digest_of(place)
    return digests


def software_versions() -> dict[str, str]:
    """Versions of Python, this project and `PACKAGES`, by name."""
    return {
        "python": platform.python_version(),
        "drftjax": drftjax.__version__,
        **{name: version(name) for name in PACKAGES},
    }


def _machine() -> Machine:
    import jax

    return Machine(
        system=f"{platform.system()} {platform.machine()}",
        precision=jax.dtypes.canonicalize_dtype(float).name,
        backend=jax.default_backend(),
        devices=jax.device_count(),
        threads=os.cpu_count(),
    )


def encodable(text: str) -> str:
    """Text of a file name that JSON can hold: bytes that are no UTF-8 become escapes."""
    return os.fsencode(text).decode(errors="backslashreplace")
