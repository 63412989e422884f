"""Numbers of effects as parameters of a fit: `drawbar.force`, `speed_lag.lag`."""

import math
from functools import cache

import equinox as eqx
from jaxtyping import Array, Float

from drftjax.common.errors import InputError
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import catalogue, effect_class, field_metadata
from drftjax.simulation.trial import Trial
from identify.parameters.bijector import AbstractBijector, Interval, Positive, Scaled
from identify.parameters.quantity import Quantity


def effect_numbers() -> list[str]:
    """Return the names of every number of every effect, as NAME.NUMBER."""
    return [
        f"{name}.{field}"
        for name, effect in catalogue().items()
        for field in field_metadata(effect)
    ]


@cache  # programs are compiled for the very functions in it
def effect_quantity(name: str) -> Quantity | None:
    """Return a number of an effect by NAME.NUMBER; None for a name of no effect.

    Raises:
        InputError: where the effect has no such number.
    """
    title, _, field = name.partition(".")
    if title not in catalogue():
        return None
    effect = effect_class(title)
    about = field_metadata(effect)
    if field not in about:
        has = ", ".join(f"{title}.{each} [{known['unit']}]" for each, known in about.items())
        raise InputError(f"the effect {title!r} has no number {field!r} to fit; it has {has}")

    def get(trial: Trial) -> Float[Array, ""]:
        return getattr(trial.simulator.effects[_place(trial, effect)], field)

    def put(trial: Trial, value: Float[Array, ""]) -> Trial:
        place = _place(trial, effect)
        return eqx.tree_at(lambda t: getattr(t.simulator.effects[place], field), trial, value)

    return Quantity(name, about[field]["unit"], get, put, _bijector(about[field]))


def _place(trial: Trial, effect: type[AbstractEffect]) -> int:
    for place, each in enumerate(trial.simulator.effects):
        if type(each) is effect:
            return place
    raise AttributeError(effect.about.name)


def _bijector(about: dict) -> AbstractBijector:
    if about["least"] == 0:
        return Positive() if math.isinf(about["most"]) else Interval(0.0, about["most"])
    # Of what may have any value, a place alone has no typical size.
    return Scaled(about.get("typical", 0.1))
