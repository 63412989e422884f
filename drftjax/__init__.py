"""Dynamic resistive force theory for rover wheels on sand, on JAX.

The public names below are imported on first use, so that `import drftjax` and `drft --help` stay
fast and a program can still set JAX up before it is loaded.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drftjax.errors import InputError as InputError

__version__ = "0.1.0"

_HOMES = {
    "InputError": "drftjax.errors",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value  # the next access finds it without asking here
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
