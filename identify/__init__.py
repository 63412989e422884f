"""Identification: zeta, lambda and other numbers of the simulator from recorded runs.

    import identify

    result = identify.fit("data/runs/fast.h5")

The public names below are imported on first use, so that a program can still set JAX up before it
is loaded.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identify.interface import fit as fit
    from identify.parameter import Parameter as Parameter
    from identify.parameter import own as own
    from identify.parameter import shared as shared
    from identify.result import FitResult as FitResult

_HOMES = {
    "FitResult": "identify.result",
    "Parameter": "identify.parameter",
    "fit": "identify.interface",
    "own": "identify.parameter",
    "shared": "identify.parameter",
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
