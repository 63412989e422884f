"""Files that ship with the project, and classes that other installed packages add to it."""

import inspect
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, TypeVar

from drftjax.common.errors import InputError, did_you_mean

Kind = TypeVar("Kind")


_PACKAGE: Final = Path(__file__).resolve().parents[1]


_HOMES: Final = (_PACKAGE / "_data", _PACKAGE.parent / "data")


def data_file(name: str) -> Path:
    """Path of a file below data/, such as "import/cmu_intrusion.toml".

    Raises:
        InputError: no such file ships with the project.
    """
    for home in _HOMES:
        if (home / name).is_file():
            return home / name
    raise InputError(f"there is no {name} in the data that ships with the project")


def data_names(folder: str, suffix: str) -> list[str]:
    """Names, without the suffix, of the files in a folder below data/."""
    found = {each.stem for home in _HOMES for each in (home / folder).glob(f"*{suffix}")}
    return sorted(found)


def optional_package(module: str, purpose: str) -> Any:
    """Import a package that drftjax does without, but for this purpose.

    Args:
        module: Name of the package.
        purpose: What needs it, for the error message, such as "to_xarray".

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{purpose} needs the package {module}, which is not installed: pip install {module}"
        ) from None


def load_plugins(group: str, kind: type[Kind], noun: str) -> Iterator[tuple[str, str, type[Kind]]]:
    """Classes that installed packages add by an entry-point group.

    Args:
        group: Entry-point group, such as "drft.tuners".
        kind: Class that all of them derive from.
        noun: One of them in a sentence, such as "tuner".

    Yields:
        Name of the entry point, the plug-in in the words of an error message, and its class.

    Raises:
        InputError: names an entry point that cannot be loaded, or gives another kind of object.
    """
    for entry in entry_points(group=group):
        label = f"the {noun} {entry.name!r} of {entry.value}"
        try:
            added = entry.load()
        except Exception as error:
            raise InputError(f"{label} fails: {error}") from None
        if not (isinstance(added, type) and issubclass(added, kind)):
            raise InputError(f"{label} is no {noun} class")
        yield entry.name, label, added


def require_concrete(added: type, label: str, noun: str) -> None:
    """Refuse a plug-in's class that leaves abstract methods open.

    Raises:
        InputError: names the missing methods.
    """
    if inspect.isabstract(added):
        missing = ", ".join(sorted(added.__abstractmethods__))
        raise InputError(f"{label} lacks {missing}, which every {noun} has")


def with_plugins(
    own: Mapping[str, type[Kind]], group: str, kind: type[Kind], noun: str
) -> dict[str, type[Kind]]:
    """A registry of classes by name: the project's own, then those that installed packages add.

    Args:
        own: The project's classes by name.
        group, kind, noun: As for `load_plugins`.

    Raises:
        InputError: names a plug-in that is no such class, is abstract, or takes a name twice.
    """
    known = dict(own)
    for name, label, added in load_plugins(group, kind, noun):
        require_concrete(added, label, noun)
        if name in known:
            raise InputError(f"{label} is there already")
        known[name] = added
    return known


def require_known(entry: str, name: str, known: Iterable[str]) -> None:
    """Refuse a name that a registry does not hold.

    Args:
        entry: Place of the name in a file or a command, such as "terrain.law".
        name: Given name.
        known: Names in the registry.

    Raises:
        InputError: lists the known names, and the nearest one.
    """
    known = list(known)
    if name not in known:
        hint = did_you_mean(name, known, most=1, cutoff=0.4)
        listed = ", ".join(map(repr, known))
        must = f"one of {listed}" if len(known) > 1 else listed
        raise InputError(f"{entry} is {name!r}, must be {must}{hint}")
