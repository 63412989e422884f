"""What a run's numbers cannot mean although the format allows them: a wrong sign, another unit."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.record import RunLog

GRAVITY: Final = 9.81


HARDEST_SAND: Final = 3e6


"""Stress under depth that no dry sand reaches [N/m3]: three times the generic one of RFT."""


ZEROING: Final = 5e-4


"""Touch-down is found to this by hand [m]."""


LARGEST: Final = {
    ("command", "omega"): (10.0, "rad/s", "deg/s"),
    ("measured", "x"): (50.0, "m", "mm"),
    ("measured", "z"): (1.0, "m", "mm"),
}


"""Larger numbers than these on a rig are likely of the unit that stands last."""


def height_problems(z: NDArray[np.float64], setup: Mapping[str, float]) -> Iterator[str]:
    """A wheel that stands on nothing: z was counted downward, or from elsewhere.

    The sand bears at most as the hardest under the circle of the grousers' tips, where the wheel
    is at its lowest. Without the wheel's size and mass nothing is said.

    Args:
        z: Height of the rim over touch-down [m].
        setup: Numbers of /setup by name, those that are known.
    """
    needed = ("wheel_radius", "wheel_width", "mass_z")
    if not z.size or any(name not in setup for name in needed):
        return
    radius, width, mass = (float(setup[name]) for name in needed)
    grousers = float(setup.get("grouser_height", 0.0)) if setup.get("grouser_count") else 0.0
    lowest = float(z.min())
    depth = min(max(grousers + ZEROING - lowest, 0.0), radius)
    chord = 2 * np.sqrt(depth * (2 * (radius + grousers) - depth))
    if lowest > ZEROING and HARDEST_SAND * depth * width * chord < mass * setup.get(
        "gravity", GRAVITY
    ):
        yield (
            f"stands {1e3 * lowest:.3g} mm or more above touch-down throughout, where no sand "
            "carries the wheel; z counts upward from touch-down, so sinkage is -z"
        )


def standing_problems(setup: Mapping[str, float]) -> Iterator[str]:
    """A static sinkage with which the wheel stands on nothing: counted upward, as z is.

    Args:
        setup: Numbers of /setup by name, those that are known.
    """
    sinkage = float(setup.get("sinkage_static", 0.0))
    if any(height_problems(np.array([-sinkage]), setup)):
        yield (
            f"is {1e3 * sinkage:.3g} mm, of a wheel above the sand, where nothing carries it; "
            "sinkage counts downward from touch-down"
        )


def unit_problems(
    title: str, name: str, values: NDArray[np.float64], setup: Mapping[str, float]
) -> Iterator[str]:
    """A channel of a size that only another unit explains.

    Args:
        title, name: Group and channel.
        values: The channel, in the format's unit.
        setup: Numbers of /setup by name, those that are known.
    """
    if (title, name) not in LARGEST or not values.size:
        return
    largest, unit, likely = LARGEST[title, name]
    if name == "z":
        largest = float(setup.get("wheel_radius", largest))
    reached = float(np.abs(values).max())
    if reached > largest:
        yield (
            f"reaches {reached:.4g} {unit}, more than {largest:g} {unit}; perhaps these are "
            f"{likely}, which must be written as {unit}"
        )


def require_upright(run: RunLog) -> None:
    """Refuse a run whose wheel stands above the sand throughout.

    Raises:
        InputError: says how far, and how z counts.
    """
    if run.measured.z is not None:
        for reason in height_problems(run.measured.z, run.setup.known()):
            raise InputError(f"measured z {reason}")


def doubts(run: RunLog) -> Iterator[str]:
    """What `drft log check` finds in the numbers of a run, in sentences.

    Args:
        run: As it is to be written.
    """
    setup = run.setup.known()
    for reason in standing_problems(setup):
        yield f"/setup/sinkage_static {reason}"
    for title, name in LARGEST:
        values = getattr(getattr(run, title), name)
        if values is not None:
            reasons = [*unit_problems(title, name, values, setup)]
            reasons += height_problems(values, setup) if name == "z" else ()
            for reason in reasons:
                yield f"/{title}/{name} {reason}"
