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
        min_rate: Slower readings are likely milliseconds taken for seconds [1/s]; logs of a wheel
            have 10 a second and more.
        min_rows: Fewer readings have no rate: means and single values.
        max_duration: Longer runs are likely so, too: a wheel of 10 mm/s would go 36 m [s].
        path_ratio: Largest ratio of the rim's path to the wheel's, or the other way round, that is
            taken without a note [-]; three is a slip of two thirds.
        min_path: Paths that are both shorter are not compared, in radii [-].
        end_share: Share of the driven readings, the last ones, whose middle height is judged [-].
    """

    max_stress_gradient: float = 3e6
    touchdown_accuracy: float = 5e-4
    max_omega: float = 10.0
    max_travel: float = 50.0
    max_height: float = 1.0
    min_rate: float = 1.0
    min_rows: int = 10
    max_duration: float = 3600.0
    path_ratio: float = 3.0
    min_path: float = 1.0
    end_share: float = 0.1


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


Columns = Mapping[tuple[str, str], NDArray[np.float64]]
"""Columns by group and name, such as ("measured", "x")."""

_OMEGA_UNITS: Final = {"rpm": np.pi / 30, "deg/s": np.pi / 180, "rev/s": 2 * np.pi}


def motion_problems(
    columns: Columns, setup: Mapping[str, float], limits: PlausibilityLimits = LIMITS
) -> Iterator[tuple[str, str]]:
    """Places and reasons why time, speed and travel of a run are unlikely to belong together.

    Args:
        columns: Finite columns of /command and /measured, each as long as its time.
        setup: Numbers of /setup that are known, by name.
        limits: Rates, durations and ratios of a rig.
    """
    units_fit = not any(
        True
        for title, name in (("command", "omega"), ("measured", "x"))
        for _ in unit_problems(title, name, columns.get((title, name), np.zeros(0)), setup, limits)
    )
    time = columns.get(("measured", "time"), np.zeros(0))
    if time.size >= limits.min_rows:
        span = float(time[-1] - time[0])
        rate = (time.size - 1) / span
        seconds = "perhaps these are milliseconds, which must be written as s"
        if rate < limits.min_rate:
            yield "/measured/time", f"has {rate:.2g} readings a second; {seconds}"
            units_fit = False
        elif span > limits.max_duration:
            yield "/measured/time", f"is {span / 3600:.3g} h long; {seconds}"
            units_fit = False
    driven = ("command", "vx") in columns
    # One note for one cause: of these three, another unit breaks the ratio of the paths, too.
    if units_fit and not driven and {("command", "omega"), ("measured", "x")} <= columns.keys():
        yield from (("/measured/x", each) for each in _path_problems(columns, setup, limits))
    z = columns.get(("measured", "z"), np.zeros(0))
    stands = not any(True for _ in height_problems(z, setup, limits))
    if stands and {("command", "omega"), ("measured", "z")} <= columns.keys():
        yield from (("/measured/z", each) for each in _end_problems(columns, setup, limits))


def _path_problems(
    columns: Columns, setup: Mapping[str, float], limits: PlausibilityLimits
) -> Iterator[str]:
    """Reason why the rim's path and the free wheel's are of different units."""
    radius = setup.get("wheel_radius")
    time, omega = columns["command", "time"], columns["command", "omega"]
    if radius is None or time.size < 2:
        return
    turned = np.cumsum(np.diff(time) * (omega[1:] + omega[:-1]) / 2)
    x = columns["measured", "x"]
    rim, travel = float(radius * np.abs(turned).max()), float(np.abs(x - x[0]).max())
    if max(rim, travel) < limits.min_path * radius:
        return
    if rim > limits.path_ratio * travel:
        ratio = rim / travel if travel > 0 else np.inf
        likely = [
            name
            for name, factor in _OMEGA_UNITS.items()
            if 1 / limits.path_ratio < ratio * factor < limits.path_ratio
        ]
        unit = f"perhaps omega is in {likely[0]}" if likely else "perhaps one is in another unit"
        slip = f"unless the slip is {1 - 1 / ratio:.0%}"
        paths = f"goes {travel:.3g} m while the rim goes {rim:.3g} m, {ratio:.1f} times as far"
        yield f"{paths}; {unit}, {slip}"
    elif travel > limits.path_ratio * rim:
        yield (
            f"goes {travel:.3g} m while the rim goes {rim:.3g} m; a free wheel does not go "
            f"{limits.path_ratio:g} times as far as its rim: perhaps x or omega is in another unit"
        )


def _end_problems(
    columns: Columns, setup: Mapping[str, float], limits: PlausibilityLimits
) -> Iterator[str]:
    """Reason why a wheel that ends above the sand, though it drives, is unlikely."""
    omega = np.abs(columns["command", "omega"])
    time, z = columns["measured", "time"], columns["measured", "z"]
    turning = np.interp(time, columns["command", "time"], omega) > 0
    driven = z[turning]
    if driven.size < limits.min_rows:
        return
    end = float(np.median(driven[-max(1, int(limits.end_share * driven.size)) :]))
    tips = float(setup.get("grouser_height", 0.0)) if setup.get("grouser_count") else 0.0
    if end > tips + limits.touchdown_accuracy:
        yield (
            f"ends {1e3 * end:.3g} mm above touch-down while the wheel drives; look at the sign "
            "and the zero of z, unless the bed rises"
        )


def motion_columns(run: RunLog) -> Columns:
    """Columns of a run for `motion_problems`."""
    records = {"command": run.command, "measured": run.measured}
    pairs = ((title, name) for title in records for name in UNITS[title])
    found = {pair: getattr(records[pair[0]], pair[1]) for pair in pairs}
    return {pair: values for pair, values in found.items() if values is not None}


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
    for where, reason in motion_problems(motion_columns(run), setup, limits):
        yield f"{where} {reason}"
