"""Units and signs of the channels of a table, found out from headings and ranges."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.importers import units
from drftjax.runlog.importers.guess.words import DOWNWARD, NamedColumn

Reals = NDArray[np.float64]

KINDS = {"time": "s", "omega": "rad/s", "vx": "m/s", "x": "m", "z": "m"} | {
    "fx": "N",
    "fz": "N",
    "torque": "N m",
}
"""Unit of each channel in a run log."""


@dataclass(frozen=True)
class UnitRanges:
    """Ranges by which an unstated unit is recognised.

    Attributes:
        max_step: Longest step of a clock in seconds; wheels are read more often [s].
        min_radius, max_radius: Rims of single-wheel rigs and rovers, times one less the slip [m].
        usual_radius: Middle of them, to choose among units that all fit [m].
        max_travel: Larger numbers are millimetres [m].
        max_height: Larger numbers are millimetres [m].
        max_speed: Larger carriage speeds are millimetres a second [m/s].
        max_omega: Larger wheel speeds, where no travel tells, are degrees a second [rad/s].
        max_start: Largest first travel, over all of it, of a scale that was zeroed [-].
    """

    max_step: float = 1.0
    min_radius: float = 0.02
    max_radius: float = 0.6
    usual_radius: float = 0.12
    max_travel: float = 5.0
    max_height: float = 1.0
    max_speed: float = 1.0
    max_omega: float = 10.0
    max_start: float = 0.1


DEFAULT_RANGES = UnitRanges()


@dataclass(frozen=True)
class GuessedChannel:
    """Source of a channel.

    Attributes:
        unit: Its unit.
        keys: Further keys of the mapping.
        doubts: Sentences on what is unsure.
    """

    unit: str
    keys: Mapping[str, object] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()


def guess_time(
    named: NamedColumn, time: Reals, settings: UnitRanges = DEFAULT_RANGES
) -> GuessedChannel:
    """Unit and zero of a clock.

    Args:
        named: Its heading.
        time: Its counts of one run, in its own unit, shape (rows,).
        settings: Ranges by which the unit is recognised.
    """
    step = float(np.median(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    start = abs(float(time[0])) if len(time) else 0.0
    keys = {"zero_at_first_row": True} if start > 10 * step > 0 else {}
    epochs = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s"))
    epoch = next((unit for least, unit in epochs if start > least), None)
    by_step = next((u for most, u in ((1.0, "s"), (1e3, "ms"), (1e6, "us")) if step <= most), "ns")
    if named.unit is None:
        unit = epoch or by_step
        sure = epoch is not None
        doubts = () if sure else (f"its unit is not stated; steps of {step:g} look like {unit}",)
        return GuessedChannel(unit, keys, doubts)
    seconds = step * units.unit(named.unit).factor
    doubts = ()
    if seconds > settings.max_step:
        doubts = (f"in {named.unit} there is a row every {seconds:g} s; perhaps it is {by_step}",)
    return GuessedChannel(named.unit, keys, doubts)


def guess_omega(
    named: NamedColumn,
    omega: Reals,
    time: Reals | None,
    x: Reals | None,
    settings: UnitRanges = DEFAULT_RANGES,
) -> GuessedChannel:
    """Unit of a wheel speed: by the radius on which the wheel would roll its travel.

    Args:
        named: Its heading.
        omega: Its values of one run, in its own unit, shape (rows,).
        time: Times of the same rows [s]; None where they are not known.
        x: Travel at the same rows [m]; None where it is not known.
        settings: Radii and speeds by which the unit is recognised.
    """
    candidates = ("rad/s", "deg/s", "rpm")
    radii: dict[str, float] = {}
    if time is not None and x is not None:
        turned = float(
            np.abs(np.cumsum(np.diff(time) * (omega[1:] + omega[:-1]) / 2)).max(initial=0)
        )
        travel = float(np.abs(x - x[0]).max())
        if turned > 0 and travel > 0:
            known = {*candidates, *([named.unit] if named.unit else [])}
            radii = {each: travel / (turned * units.unit(each).factor) for each in known}
    fit = [
        each
        for each in candidates
        if settings.min_radius <= radii.get(each, 0.0) <= settings.max_radius
    ]
    ways = ", ".join(f"in {each} on {1e3 * radii[each]:.3g} mm" for each in candidates if radii)
    if named.unit is not None:
        inside = settings.min_radius <= radii.get(named.unit, 1.0) <= settings.max_radius
        if named.unit in radii and not inside:
            return GuessedChannel(named.unit, {}, (f"the wheel would roll {ways}",))
        return GuessedChannel(named.unit)
    if fit:
        fit.sort(key=lambda each: abs(np.log(radii[each] / settings.usual_radius)))
        doubt = f"its unit is not stated; the wheel would roll {ways}, or more where it slips"
        return GuessedChannel(fit[0], {}, (doubt,))
    unit = "deg/s" if float(np.abs(omega).max(initial=0)) > settings.max_omega else "rad/s"
    doubt = f"its unit is not stated, and no travel tells; {unit} by its range, else rpm"
    return GuessedChannel(unit, {}, (doubt,))


def guess_channel(
    role: str, named: NamedColumn, values: Reals, settings: UnitRanges = DEFAULT_RANGES
) -> GuessedChannel:
    """Unit, sign and zero of a speed, a path, a height, a force or a torque.

    Args:
        role: Name of the channel.
        named: Its heading.
        values: Its values of one run, in its own unit, shape (rows,).
        settings: Ranges by which the unit is recognised.
    """
    largest = float(np.abs(values).max(initial=0.0))
    limits = {"x": settings.max_travel, "z": settings.max_height, "vx": settings.max_speed}
    small = {"x": "mm", "z": "mm", "vx": "mm/s"}
    doubts: list[str] = []
    unit = named.unit
    if unit is None:
        unit = small[role] if largest > limits.get(role, np.inf) else KINDS[role]
        doubts.append(f"its unit is not stated; it reaches {largest:.4g}, which looks like {unit}")
    keys: dict[str, object] = {}
    if role == "z":
        keys, more = _height_sign(named, values)
        doubts += more
    elif role == "fz" and float(np.median(values)) < 0:
        keys = {"sign": -1}
        doubts.append("it is negative; fz is the sand's force upward on the wheel")
    elif role == "fx":
        doubts.append("fx must be the sand's force forward on the wheel; else write sign = -1")
    elif role == "x" and len(values):
        travel = float(np.abs(values - values[0]).max())
        if abs(float(values[0])) > settings.max_start * travel > 0:
            keys = {"zero_at_first_row": True}
            doubts.append(f"it begins at {values[0]:g}; it is counted from the first row")
        if float(values[-1] - values[0]) < -0.5 * travel:
            keys |= {"sign": -1}
            doubts.append("it falls; x must grow forward")
    return GuessedChannel(unit, keys, tuple(doubts))


def _height_sign(named: NamedColumn, values: Reals) -> tuple[dict[str, object], list[str]]:
    """Sign by which a height counts upward."""
    downward = any(part in word for part in DOWNWARD for word in named.words)
    middle = float(np.median(values))
    keys: dict[str, object] = {"sign": -1} if middle > 0 else {}
    if downward and middle > 0:
        return keys, []
    if downward:
        return keys, [
            "it is negative, though its name counts downward; z must be minus the sinkage"
        ]
    if middle > 0:
        return keys, [
            "it is positive, so it is taken to count downward; if it is the height over another "
            "zero, give an offset: z = 0 where the rim touches the sand, upward"
        ]
    return keys, []
