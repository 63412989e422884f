"""Diagnosis: which unmodelled effect makes a rig's runs differ from the model, where, how much.

    import diagnose

    found = diagnose.diagnose("data/blind/demo")

The public names below are imported on first use, so that a program can still set JAX up before it
is loaded.
"""

from typing import TYPE_CHECKING

from drftjax.lazy import lazily

if TYPE_CHECKING:
    from diagnose.diagnosis import Diagnosis as Diagnosis
    from diagnose.evaluation import Evaluation as Evaluation
    from diagnose.interface import diagnose as diagnose
    from diagnose.interface import evaluate as evaluate

_HOMES = {
    "Diagnosis": "diagnose.diagnosis",
    "Evaluation": "diagnose.evaluation",
    "diagnose": "diagnose.interface",
    "evaluate": "diagnose.interface",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

__getattr__, __dir__ = lazily(globals(), _HOMES)
