"""Public names that are imported on first use, and packages that another distribution may hide."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).absolute().parents[2]


def lazily(
    package: dict[str, Any], homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """A package's `__getattr__` and `__dir__` (PEP 562).

    Args:
        package: Its globals.
        homes: The module that each name comes from.
    """

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        package[name] = getattr(import_module(homes[name]), name)
        return package[name]

    return get, lambda: sorted({*package, *homes})


def uncover(name: str) -> None:
    """Let the modules of a package of this project be found where another package hides it.

    In an editable installation, `identify` of pre-commit stands in site-packages and is found
    before the checkout. Its `__init__.py` is empty: to import it costs nothing.

    Args:
        name: Of the package.
    """
    with suppress(ModuleNotFoundError):
        path, own = import_module(name).__path__, str(_ROOT / name)
        if own not in path:
            path.append(own)
