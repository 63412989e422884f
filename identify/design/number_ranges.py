"""Ranges that numbers of a set-up are screened over: the usual ones, and those of the user."""

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drftjax.common.errors import InputError
from drftjax.effects.catalogue import catalogue, effect_class, field_metadata, strengths
from drftjax.effects.serialization import name_of
from drftjax.setups.setup import SetUp
from drftjax.simulation.trial import Trial
from identify.parameters.parameter import Quantity, quantity

Bounds = tuple[float, float]


@dataclass(frozen=True)
class RangeWidth:
    """Width of the range that a number is screened over.

    Attributes:
        name: The number, as `drft fit` calls it.
        width: Of the range, in the number's unit, or as a share of its value.
        relative: True for a share.
        least, most: Smallest and largest value with a meaning, in its unit.
    """

    name: str
    width: float
    relative: bool = False
    least: float = -math.inf
    most: float = math.inf


def _widths() -> tuple[RangeWidth, ...]:
    # As little is known before a rig is measured: our judgement, to be replaced by what is.
    return (
        RangeWidth("zeta", 0.1, relative=True),  # a bed that is prepared again
        RangeWidth("lambda", 1.0),  # the typical size of the effect momentum_flux
        RangeWidth("terrain.bulk_density", 0.1, relative=True),  # loose to dense sand
        RangeWidth("wheel.width", 0.02, relative=True),  # worn edges
        RangeWidth("rig.mass_x", 0.05, relative=True),  # cables and guides that move along
        RangeWidth("rig.mass_z", 0.02, relative=True),  # weighed, but hung on guides
        # The typical sizes of horizontal_viscous, vertical_viscous and drawbar, which act alike.
        RangeWidth("rig.damping_x", 30.0, least=0.0),
        RangeWidth("rig.damping_z", 1000.0, least=0.0),
        RangeWidth("rig.drawbar_load", 5.0),
        RangeWidth("start.sinkage", 1e-3),  # the scale's zero is found by hand
        RangeWidth("start.angle", 0.1),  # a fifth of the pitch of twelve grousers
    )


@dataclass(frozen=True)
class RangeSettings:
    """Numbers that are screened, and how far.

    A strength of an effect goes over its typical size: from 0 where it cannot be negative, else
    half of it to either side.

    Attributes:
        widths: Of the numbers that are no effects'; a reason stands beside each.
        max_rows: Rows of a run at most: longer runs have them farther apart, as all rows of a
            screening are kept at once.
        most_failed: Share of the simulations that may fail [-]: past it the ranges are no
            neighbourhood of the set-up any more.
    """

    widths: tuple[RangeWidth, ...] = dataclasses.field(default_factory=_widths)
    max_rows: int = 3000
    most_failed: float = 0.5


@dataclass(frozen=True)
class NumberRange:
    """Range that a number is screened over.

    Attributes:
        quantity: The number.
        value: The set-up's, in its unit.
        low, high: Ends of the range.
    """

    quantity: Quantity
    value: float
    low: float
    high: float


def number_ranges(
    setup: SetUp, trial: Trial, given: Mapping[str, Bounds], choices: RangeSettings
) -> tuple[tuple[NumberRange, ...], dict[str, str]]:
    """Range of every number: those given, else the usual ones.

    Args:
        setup: Set-up, with all effects that its wheel and sand admit.
        trial: Built from it.
        given: Lowest and highest value of some numbers, by name.
        choices: Usual ranges.

    Returns:
        The ranges, and the reasons why other numbers have none, by label.

    Raises:
        InputError: a name that is not known, or a range that cannot be.
    """
    wanted = {quantity(name).name: bounds for name, bounds in given.items()}
    if len(wanted) < len(given):
        raise InputError(f"a range is given twice among {', '.join(given)}; give each once")
    usual = {quantity(each.name).name: each for each in choices.widths}
    for name, effect in catalogue().items():
        if any(name_of(entry) == name for entry in setup.effects):
            about = field_metadata(effect)
            for field in strengths(effect):
                full = f"{name}.{field}"
                usual[full] = RangeWidth(
                    full,
                    about[field]["typical"],
                    least=about[field]["least"],
                    most=about[field]["most"],
                )
    found, lacking = [], {}
    for name in dict.fromkeys([*usual, *wanted]):
        what = quantity(name)
        try:
            value = float(what.read(trial))
            low, high = wanted[name] if name in wanted else usual_range(value, usual[name])
            _require_range(setup, what, low, high)
        except InputError as problem:
            if name in wanted:
                raise
            lacking[what.label] = f"{problem}"
            continue
        found.append(NumberRange(what, value, low, high))
    return tuple(found), lacking


def usual_range(value: float, width: RangeWidth) -> Bounds:
    """Return the range of this width about a value, moved to where it keeps its bounds."""
    across = width.width * abs(value) if width.relative else width.width
    low = max(width.least, value - across / 2)
    high = min(width.most, low + across)
    return max(width.least, high - across), high


def _require_range(setup: SetUp, what: Quantity, low: float, high: float) -> None:
    """Raise InputError for a range that is none, or whose ends no set-up may have."""
    if not low < high or not math.isfinite(high - low):
        raise InputError(
            f"the range of {what.label} is {low:g} to {high:g}; both must be finite, and the first "
            "less than the second"
        )
    for end in (low, high):
        changed = copy.deepcopy(setup)
        what.record(changed, end)
        try:
            changed.trial()
        except InputError as problem:
            raise InputError(
                f"the range of {what.label} is {low:g} to {high:g}; at {end:g} {problem}"
            ) from None


def add_effects(setup: SetUp, channels: Sequence[str]) -> dict[str, str]:
    """Add all effects that a set-up's wheel, sand and carriage admit, at zero strength.

    Args:
        setup: Changed in place.
        channels: Channels that are measured; what shows in none of them is not added.

    Returns:
        Reasons why others are not admitted, by name.
    """
    excluded = {}
    simulator = setup.trial().simulator
    present = [name_of(entry) for entry in setup.effects]
    for name in catalogue():
        # A sum moves the runs as its terms do, which are there.
        if name in present or effect_class(name).about.sum_of:
            continue
        try:
            effect_class(name).about.require_shown(channels)
            dataclasses.replace(simulator, effects=(effect_class(name)(),)).check()
        except InputError as problem:
            excluded[name] = f"{problem}"
        else:
            setup.effects.append({"name": name})
    return excluded
