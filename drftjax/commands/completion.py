"""Names that a shell completes: of effects, tuners and channels.

A key press must not wait for JAX, which the modules of effects and tuners import. Their names are
therefore read from the sources; those that other packages add, from their entry points.
"""

import re
from collections.abc import Iterable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_EFFECT: Final = re.compile(r'EffectInfo\(\s*"(\w+)"')
CHANNEL_NAMES: Final = ("x", "z", "fx", "fz", "torque")
_TUNER: Final = re.compile(r'^    "(\w+)": \w+Tuner,$', re.MULTILINE)


def complete_effect(incomplete: str) -> list[str]:
    """Names of effects that begin so."""
    return _beginning(incomplete, effect_names())


def complete_effects(incomplete: str) -> list[str]:
    """Lists of effects with commas between, the last name completed."""
    earlier, comma, last = incomplete.rpartition(",")
    return [f"{earlier}{comma}{each}" for each in _beginning(last, effect_names())]


def complete_tuner(incomplete: str) -> list[str]:
    """Names of tuners that begin so."""
    return _beginning(incomplete, tuner_names())


def complete_channel(incomplete: str) -> list[str]:
    """Names of the channels of a run that begin so."""
    return _beginning(incomplete, CHANNEL_NAMES)


def effect_names() -> Iterator[str]:
    """Names of all effects, by their modules and by entry points."""
    for module in sorted((_PACKAGE / "effects").glob("*.py")):
        yield from _EFFECT.findall(module.read_text(encoding="utf-8"))
    yield from (each.name for each in entry_points(group="drft.effects"))


def tuner_names() -> Iterator[str]:
    """Names of all tuners, by their registry and by entry points."""
    yield from _TUNER.findall((_PACKAGE / "tuning" / "registry.py").read_text(encoding="utf-8"))
    yield from (each.name for each in entry_points(group="drft.tuners"))


def _beginning(start: str, names: Iterable[str]) -> list[str]:
    return [each for each in names if each.startswith(start)]
