"""Public names imported on first use, and packages that another distribution may hide."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).absolute().parents[2]


def lazy_attributes(
    package: dict[str, Any], homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and `__dir__` of a package (PEP 562).

    Args:
        package: Globals of the package.
        homes: Module that defines each name.
    """

    def get(name: str) -> Any:
        """Import the module of a name, and keep the name in the package."""
        if name not in homes:
            raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
        package[name] = getattr(import_module(homes[name]), name)
        return package[name]

    return get, lambda: sorted({*package, *homes})


def uncover(name: str) -> None:
    """Add this project's folder to the path of a package that another distribution hides.

    In an editable installation, the package `identify` of pre-commit lies in site-packages and is
    found before the one of the checkout. Its `__init__.py` is empty, so importing it is cheap.

    Args:
        name: Name of the package.
    """
    with suppress(ModuleNotFoundError):
        path, own = import_module(name).__path__, str(_ROOT / name)
        if own not in path:
            path.append(own)
