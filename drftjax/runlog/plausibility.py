"""Warnings for numbers that the format allows and a rig cannot have: wrong signs, other units."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.record import RunLog
from drftjax.runlog.schema import UNITS

GRAVITY: Final = 9.81
"""Free-fall acceleration where a run does not give it [m/s^2]."""


@dataclass(frozen=True)
class PlausibilityLimits:
    """Numbers beyond which a run is taken for one in another unit or of another sign.

    Attributes:
        max_stress_gradient: Stress under depth that no dry sand reaches [N/m^3]: three times the
            generic one of RFT.
        touchdown_accuracy: Touch-down is found to this by hand [m].
        max_omega: Larger wheel speeds are likely in deg/s [rad/s].
        max_travel: Longer paths are likely in mm; no rig is as long [m].
        max_height: Larger heights are likely in mm, where the wheel's radius is not known, which
            takes the place of this limit [m].
    """

    max_stress_gradient: float = 3e6
    touchdown_accuracy: float = 5e-4
    max_omega: float = 10.0
    max_travel: float = 50.0
    max_height: float = 1.0


LIMITS: Final = PlausibilityLimits()

CHECKED_COLUMNS: Final = {
    ("command", "omega"): ("max_omega", "deg/s"),
    ("measured", "x"): ("max_travel", "mm"),
    ("measured", "z"): ("max_height", "mm"),
}
"""Limit of a column, and the unit that larger numbers are likely in."""


def height_problems(
    z: NDArray[np.float64], setup: Mapping[str, float], limits: PlausibilityLimits = LIMITS
) -> Iterator[str]:
    """Reasons why no sand can carry the wheel at these heights: z counted downward, or from
    elsewhere than touch-down.

    The sand bears at most the weight that the hardest one bears on the circle of the grousers'
    tips at the wheel's lowest place. Nothing is found without the wheel's size and mass.

    Args:
        z: Height of the rim over touch-down, shape (rows,) [m].
        setup: Numbers of /setup that are known, by name.
        limits: Hardest sand and accuracy of touch-down.
    """
    needed = ("wheel_radius", "wheel_width", "mass_z")
    if not z.size or any(name not in setup for name in needed):
        return
    radius, width, mass = (float(setup[name]) for name in needed)
    grousers = float(setup.get("grouser_height", 0.0)) if setup.get("grouser_count") else 0.0
    lowest = float(z.min())
    depth = min(max(grousers + limits.touchdown_accuracy - lowest, 0.0), radius)
    chord = 2 * np.sqrt(depth * (2 * (radius + grousers) - depth))
    bearing = limits.max_stress_gradient * depth * width * chord
    if lowest > limits.touchdown_accuracy and bearing < mass * setup.get("gravity", GRAVITY):
        yield (
            f"stands {1e3 * lowest:.3g} mm or more above touch-down throughout, where no sand "
            "carries the wheel; z counts upward from touch-down, so sinkage is -z"
        )


def standing_problems(
    setup: Mapping[str, float], limits: PlausibilityLimits = LIMITS
) -> Iterator[str]:
    """Reason why no sand can carry the wheel at its static sinkage: counted upward, as z is.

    Args:
        setup: Numbers of /setup that are known, by name.
        limits: As for `height_problems`.
    """
    sinkage = float(setup.get("sinkage_static", 0.0))
    if any(height_problems(np.array([-sinkage]), setup, limits)):
        yield (
            f"is {1e3 * sinkage:.3g} mm, of a wheel above the sand, where nothing carries it; "
            "sinkage counts downward from touch-down"
        )


def unit_problems(
    title: str,
    name: str,
    values: NDArray[np.float64],
    setup: Mapping[str, float],
    limits: PlausibilityLimits = LIMITS,
) -> Iterator[str]:
    """Reason why a column is likely in another unit than the format's.

    Args:
        title: Name of the group.
        name: Name of the column.
        values: Column in the format's unit, shape (rows,).
        setup: Numbers of /setup that are known, by name.
        limits: Largest numbers that a rig can have.
    """
    if (title, name) not in CHECKED_COLUMNS or not values.size:
        return
    limit, likely = CHECKED_COLUMNS[title, name]
    largest, unit = getattr(limits, limit), UNITS[title][name]
    if name == "z":
        largest = float(setup.get("wheel_radius", largest))
    reached = float(np.abs(values).max())
    if reached > largest:
        yield (
            f"reaches {reached:.4g} {unit}, more than {largest:g} {unit}; perhaps these are "
            f"{likely}, which must be written as {unit}"
        )


def require_upright(run: RunLog, limits: PlausibilityLimits = LIMITS) -> None:
    """Refuse a run whose wheel is above the sand throughout, as where z counts downward.

    Raises:
        InputError: by how much, and from where z counts.
    """
    if run.measured.z is not None:
        for reason in height_problems(run.measured.z, run.setup.known(), limits):
            raise InputError(f"measured z {reason}")


def plausibility_warnings(run: RunLog, limits: PlausibilityLimits = LIMITS) -> Iterator[str]:
    """Warnings that `drft log check` gives for the numbers of a run, one sentence each."""
    setup = run.setup.known()
    for reason in standing_problems(setup, limits):
        yield f"/setup/sinkage_static {reason}"
    for title, name in CHECKED_COLUMNS:
        values = getattr(getattr(run, title), name)
        if values is not None:
            reasons = [*unit_problems(title, name, values, setup, limits)]
            reasons += height_problems(values, setup, limits) if name == "z" else ()
            for reason in reasons:
                yield f"/{title}/{name} {reason}"
