"""Strengths of mechanisms by the size that they are wanted to have, and their labels."""

from collections.abc import Callable, Collection

import numpy as np

from diagnose.blind.generation.effect_size import EffectSizeProbe
from diagnose.blind.generation.random_mechanisms import UNKNOWN, Mechanism
from diagnose.blind.generation.random_rigs import strength_of
from diagnose.blind.generation.settings import GenerationRequest
from diagnose.blind.plant.plant import Part, groups_of
from drftjax.effects.catalogue import effect_class, field_metadata

# Numbers of the effects of `drftjax.effects` that mean the same as the strength of the plant's own
# form. Of two, the strength is the length of the vector that they make.
SAME_NUMBERS: dict[str, tuple[str, ...]] = {
    "loosening": ("loss",),
    "surface_slope": ("slope",),
    "cohesion": ("depth",),
    "excavation": ("rate",),
    "slip_sinkage": ("rate",),
    "bulldozing": ("force",),
    "momentum_flux": ("excess",),
    "height_decrease": ("excess",),
    "wheel_radius": ("excess",),
    "grouser_height": ("excess",),
    "grouser_shadowing": ("share",),
    "eccentricity": ("along", "up"),
    "imbalance": ("along", "up"),
    "vertical_load": ("force",),
    "vertical_coulomb": ("force",),
    "vertical_viscous": ("damping",),
    "horizontal_coulomb": ("force",),
    "horizontal_viscous": ("damping",),
    "drawbar": ("force",),
    "cable_spring": ("stiffness",),
    "vertical_spring": ("stiffness",),
    "speed_gain": ("gain",),
    "speed_lag": ("lag",),
    "speed_ripple": ("cosine", "sine"),
    "backlash": ("play",),
    "sinkage_gain": ("gain",),
    "sinkage_drift": ("rate",),
    "travel_gain": ("gain",),
    "measurement_delay": ("delay",),
    "measurement_filter": ("lag",),
}


def draw_target(request: GenerationRequest, random: np.random.Generator, least: float) -> float:
    """Draw the wanted size of a mechanism, evenly in the logarithm [noise floors].

    Args:
        request: Range of the sizes.
        random: Source of the choice.
        least: Size that it has at least. A search may end a third away from the size wanted, so
            more is asked for.
    """
    low = max(request.faintest, 1.4 * least)
    return float(np.exp(random.uniform(np.log(low), np.log(max(low, request.strongest)))))


def part_of_size(
    mechanism: Mechanism,
    target: float,
    probe_of: Callable[[tuple[str, ...]], EffectSizeProbe],
    held: Collection[str] = (),
) -> tuple[Part, dict]:
    """A mechanism at the strength of a wanted size, and what a label says of it.

    Args:
        mechanism: Mechanism of settled form.
        target: Wanted size [noise floors].
        probe_of: Probe whose program holds these groups of effects.
        held: Groups that it holds in any case.
    """
    groups = groups_of([mechanism.build(mechanism.typical_strength)], held)
    strength, size = probe_of(groups).find_strength(mechanism, target)
    part = mechanism.build(strength)
    return part, {
        "name": mechanism.name,
        "kind": mechanism.kind,
        "strength": strength_of(part),
        "form": mechanism.form,
        **comparable_size(mechanism.name, part),
        "wanted_floors": target,
        **size.document(),
    }


def comparable_size(name: str, part: Part) -> dict:
    """Size of an effect in the numbers that a diagnosis states; empty where none means the same."""
    if name == UNKNOWN or name not in SAME_NUMBERS:
        return {}
    numbers = SAME_NUMBERS[name]
    unit = field_metadata(effect_class(name))[numbers[0]]["unit"]
    return {"size": {"value": strength_of(part), "unit": unit, "numbers": list(numbers)}}
