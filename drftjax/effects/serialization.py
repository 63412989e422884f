"""Effects to and from entries of a set-up file: a name, and numbers that differ from defaults.

An entry of the name `correction` is no effect of the catalogue: it names its stage and variable.
"""

import math
from collections.abc import Mapping

from drftjax.common.errors import InputError
from drftjax.effects import correction
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import effect_class, field_metadata

Entry = dict[str, str | float | list[float]]


def build_effects(
    entry: Mapping[str, str | float | list[float]] | AbstractEffect, place: int
) -> AbstractEffect:
    """Build the effect of an entry.

    Args:
        entry: Its name, and numbers by their fields; or the effect itself.
        place: Number of the entry in the file, from 1 on.

    Raises:
        InputError: names the entry, the value given and the bound that it must meet.
    """
    if isinstance(entry, AbstractEffect):
        return entry
    name = entry.get("name")
    if not isinstance(name, str):
        raise InputError(f"[[effect]] {place} needs a name; `drft effects` lists them")
    if name == correction.NAME:
        return correction.build_correction(entry)
    effect = effect_class(name)
    known = field_metadata(effect)
    given = {}
    for field, value in entry.items():
        if field == "name":
            continue
        if field not in known:
            has = ", ".join(f"{each} [{about['unit']}]" for each, about in known.items())
            raise InputError(f"the effect {name!r} has no number {field!r}; it has {has}")
        if not isinstance(value, float | int):
            raise InputError(f"{name}.{field} is {value!r}, must be a number")
        least = known[field]["least"]
        if not math.isfinite(value):
            raise InputError(f"{name}.{field} is {value:g}, must be finite")
        if value < least or (value == least and "starts" in known[field]):
            bound = "above 0" if "starts" in known[field] else f"{least:g} or more"
            raise InputError(f"{name}.{field} is {value:g}, must be {bound}")
        if value > known[field]["most"]:
            most, unit = known[field]["most"], known[field]["unit"]
            unit = "" if unit == "-" else f" {unit}"
            raise InputError(f"{name}.{field} is {value:g}{unit}, must be {most:g}{unit} or less")
        given[field] = float(value)
    return effect(**given)


def entry_of(effect: AbstractEffect) -> Entry:
    """Entry of an effect, from which `build_effects` builds it again."""
    if isinstance(effect, correction.Curve):
        return correction.entry_of(effect)
    fields = {field: float(getattr(effect, field)) for field in field_metadata(type(effect))}
    return {"name": effect.about.name, **fields}


def name_of(entry: Mapping[str, str | float | list[float]] | AbstractEffect) -> object:
    """Name of an entry's effect, or of the effect itself; None where the entry has none."""
    return entry.about.name if isinstance(entry, AbstractEffect) else entry.get("name")


def typical_effect(effect: type[AbstractEffect]) -> AbstractEffect:
    """The effect with every strength at its typical size."""
    about = field_metadata(effect)
    return effect(**{field: each["typical"] for field, each in about.items() if "typical" in each})
