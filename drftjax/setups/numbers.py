"""Numbers of a set-up by name, in the words of its file: "zeta", "rig.mass_z", "loosening.loss"."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.core as jax_core
import msgspec

from drftjax.common.errors import InputError
from drftjax.common.packages import require_known
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import field_metadata
from drftjax.effects.serialization import build_effects, name_of
from drftjax.setups.checked_table import CheckedTable
from drftjax.setups.setup import EffectEntry, SetUp

SHORT_NAMES = {"lambda": "inertial_coefficient"}
"""Names of the field for entries of a set-up file."""


def with_numbers(setup: SetUp, numbers: Mapping[str, Any]) -> SetUp:
    """A set-up with some of its numbers replaced; the one given stays as it is.

    Args:
        setup: Set-up.
        numbers: New numbers by name: an entry of any table ("zeta", or "terrain.zeta"), or that of
            an effect ("loosening.loss"). JAX may trace them.

    Raises:
        InputError: for a name that this set-up has not, and a number that cannot be.
    """
    places = number_places(setup)
    tables: dict[str, dict[str, Any]] = {}
    for name, value in numbers.items():
        section, field = _place_of(name, places)
        tables.setdefault(section, {})[field] = value
    changed: dict[str, Any] = {
        section: msgspec.structs.replace(getattr(setup, section), **values)
        for section, values in tables.items()
        if section in setup.__struct_fields__
    }
    effects = [_with_fields(each, tables.get(f"{name_of(each)}", {})) for each in setup.effects]
    return msgspec.structs.replace(setup, **changed, effects=effects)


def number_places(setup: SetUp) -> dict[str, tuple[str, str]]:
    """Table and entry of every number of a set-up, by its short name; no two tables share one."""
    found = {}
    for section in setup.__struct_fields__:
        table = getattr(setup, section)
        if isinstance(table, CheckedTable):
            for field in table.__struct_fields__:
                found[field] = section, field
    for entry in setup.effects:
        fields = field_metadata(type(build_effects(entry, 0)))
        found |= {f"{name_of(entry)}.{each}": (f"{name_of(entry)}", each) for each in fields}
    return found


def _place_of(name: str, places: Mapping[str, tuple[str, str]]) -> tuple[str, str]:
    """Table and entry of a name, which may begin with its table: "rig.mass_z"."""
    name = SHORT_NAMES.get(name, name)
    table, _, short = name.partition(".")
    if places.get(short, ("",))[0] == table:
        return places[short]
    require_known("the number", name, places)
    return places[name]


def _with_fields(entry: EffectEntry, values: Mapping[str, Any]) -> EffectEntry:
    """An effect with other numbers; one that JAX traces makes an entry the effect itself."""
    if not isinstance(entry, AbstractEffect):
        if not any(isinstance(each, jax_core.Tracer) for each in values.values()):
            return {**entry, **values}
        entry = build_effects(entry, 0)
    try:
        return dataclasses.replace(entry, **values)
    except TypeError:
        raise InputError(
            f"the effect {name_of(entry)!r} cannot be built with {', '.join(values)}"
        ) from None
