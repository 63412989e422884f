"""Identification: zeta, lambda and other numbers of the simulator from recorded runs.

    import identify

    result = identify.fit("data/runs/fast.h5")

The public names below are imported on first use, so that a program can still set JAX up before it
is loaded.
"""

from typing import TYPE_CHECKING

from drftjax.lazy import lazily

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

__getattr__, __dir__ = lazily(globals(), _HOMES)
