"""Catalogue of effects: the project's own, and those that installed packages add.

A package adds effects by the entry-point group `drft.effects`: a name, and where its class is.
"""

import dataclasses
from collections.abc import Iterable
from functools import cache

from drftjax.common.errors import InputError, did_you_mean
from drftjax.common.packages import load_plugins, require_concrete
from drftjax.effects import correction
from drftjax.effects.base import AbstractEffect, EffectInfo
from drftjax.effects.drive import DRIVE
from drftjax.effects.rig import RIG
from drftjax.effects.sensor import SENSOR
from drftjax.effects.stress import STRESS
from drftjax.effects.surface import SURFACE
from drftjax.effects.terrain import TERRAIN
from drftjax.effects.wheel import WHEEL

GROUP = "drft.effects"


# In the order that they act in a step: what turns, what touches, what bears, what reads.
OURS: tuple[type[AbstractEffect], ...] = (
    *DRIVE,
    *WHEEL,
    *TERRAIN,
    *STRESS,
    *SURFACE,
    *RIG,
    *SENSOR,
)


@cache
def catalogue() -> dict[str, type[AbstractEffect]]:
    """Classes of effects by name, the project's own first.

    Raises:
        InputError: names a plug-in that is no effect, or takes a name twice.
    """
    known = {each.about.name: each for each in OURS}
    for _, label, added in load_plugins(GROUP, AbstractEffect, "effect"):
        if not isinstance(getattr(added, "about", None), EffectInfo):
            raise InputError(
                f"{label} has no `about`; it must say its name, stage, formula and meaning"
            )
        require_concrete(added, label, "effect of its stage")
        if added.about.name in (*known, correction.NAME):
            raise InputError(f"{label} takes the name {added.about.name!r}, which is there already")
        known[added.about.name] = added
    for each in known.values():
        if each.about.form_of and each.about.form_of not in known:
            raise InputError(
                f"the effect {each.about.name!r} is a form of {each.about.form_of!r}, and there is "
                "no such effect"
            )
    return known


def effect_class(name: str) -> type[AbstractEffect]:
    """An effect's class by its name.

    Raises:
        InputError: for an unknown name, with the nearest known ones.
    """
    known = catalogue()
    if name not in known:
        hint = did_you_mean(name, known, cutoff=0.4) or "; `drft effects` lists them"
        raise InputError(f"there is no effect {name!r}{hint}")
    return known[name]


def reported_name(name: str) -> str:
    """Name of an effect in a diagnosis: that of the effect it is a form of, or its own."""
    effect = catalogue().get(name)
    return name if effect is None else effect.about.form_of or name


def reported_names(names: Iterable[str]) -> tuple[str, ...]:
    """Names of effects in a diagnosis, each once, in the order given."""
    return tuple(dict.fromkeys(reported_name(name) for name in names))


def field_metadata(effect: type[AbstractEffect]) -> dict[str, dict]:
    """An effect's fields with their units, meanings and typical sizes or starts, by name."""
    return {
        each.name: dict(each.metadata)
        for each in dataclasses.fields(effect)
        if "unit" in each.metadata
    }


def strengths(effect: type[AbstractEffect]) -> tuple[str, ...]:
    """Names of the fields that are zero where the effect is absent."""
    return tuple(name for name, about in field_metadata(effect).items() if "typical" in about)


def shapes(effect: type[AbstractEffect]) -> tuple[str, ...]:
    """Names of the fields of the effect's form."""
    return tuple(name for name, about in field_metadata(effect).items() if "starts" in about)
