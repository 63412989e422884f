"""Channels of a run for other programs: its groups, one table on one clock, derived channels."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.plausibility import GRAVITY
from drftjax.runlog.record import RunLog
from drftjax.runlog.schema import AXES, COLUMNS

Reals = NDArray[np.float64]

DERIVED = "derived"
"""Name of the group of derived channels, which has the times of /measured."""


@dataclass(frozen=True)
class ExportedChannel:
    """Column of an exported table.

    Attributes:
        values: Its values, shape (rows,); NaN where they are not known.
        unit: Their unit.
    """

    values: NDArray[Any]
    unit: str


Channels = Mapping[str, ExportedChannel]
"""Channels of one length by name, their time first."""


@dataclass(frozen=True)
class DerivedSettings:
    """Numbers of the derived channels.

    Attributes:
        window: Time over which a line is laid through the travel, whose slope is the speed of a
            free wheel [s]: noise of 20 um at 50 readings a second leaves 0.03 mm/s.
        standing_share: Share of the greatest wheel speed below which the wheel counts as standing,
            so that it has no slip [-].
    """

    window: float = 0.5
    standing_share: float = 0.01


DEFAULT_DERIVED = DerivedSettings()


def groups_of(run: RunLog, derived: bool = False) -> dict[str, Channels]:
    """Channels of each group of a run that has rows.

    Args:
        run: The run.
        derived: True to add the group of derived channels.

    Raises:
        InputError: channels are to be derived, and none can be.
    """
    found: dict[str, Channels] = {}
    for title, columns in COLUMNS.items():
        record = getattr(run, title)
        if record is None or not getattr(record, AXES[title]).size:
            continue
        pairs = ((each, getattr(record, each.name)) for each in columns)
        found[title] = {
            each.name: ExportedChannel(values, each.unit)
            for each, values in pairs
            if values is not None
        }
    if derived:
        time = {"time": ExportedChannel(run.measured.time, "s")}
        found[DERIVED] = time | derived_channels(run)
    return found


def one_table(run: RunLog, derived: bool = False) -> dict[str, ExportedChannel]:
    """Measurements, and the commands at their times, as one table.

    A command between two rows lies on the line between them. Before its first row and after its
    last it is not known.

    Args:
        run: The run.
        derived: True to add the derived channels.

    Raises:
        InputError: as for `groups_of`.
    """
    groups = groups_of(run, derived)
    time = run.measured.time
    table = {"time": groups["measured"]["time"]}
    for name, channel in groups["command"].items():
        if name != "time":
            held = np.interp(time, run.command.time, channel.values, np.nan, np.nan)
            table[name] = ExportedChannel(held, channel.unit)
    for title in ("measured", DERIVED):
        table |= {name: each for name, each in groups.get(title, {}).items() if name != "time"}
    return table


def derived_channels(
    run: RunLog, settings: DerivedSettings = DEFAULT_DERIVED
) -> dict[str, ExportedChannel]:
    r"""Channels that follow from those of a run, at the times of /measured.

    - wheel_angle: integral of the commanded speed from the first command [rad];
    - sinkage: H = -z [m];
    - speed: commanded for a driven carriage, else the slope of the travel [m/s];
    - slip: 1 - v / (r ω) [-], where the wheel turns;
    - drawbar_coefficient: fx over fz, or over the weight mass_z g where fz was not measured [-];
    - power: torque times commanded speed [W].

    Args:
        run: The run; a channel that it has not the numbers for is left out.
        settings: Window of the speed, and the speed of a standing wheel.

    Returns:
        Channels by name, shape (rows of /measured,).

    Raises:
        InputError: none can be derived.
    """
    found = dict(_derived(run, settings))
    if not found:
        raise InputError("no channel can be derived: the run has too few channels")
    return found


def _derived(run: RunLog, settings: DerivedSettings) -> Iterator[tuple[str, ExportedChannel]]:
    """Derived channels by name."""
    measured, setup, time = run.measured, run.setup, run.measured.time
    omega = np.interp(time, run.command.time, run.command.omega, np.nan, np.nan)
    yield "wheel_angle", ExportedChannel(_turned(run, time), "rad")
    if measured.z is not None:
        yield "sinkage", ExportedChannel(-measured.z, "m")
    speed = None
    if run.command.vx is not None:
        speed = np.interp(time, run.command.time, run.command.vx, np.nan, np.nan)
    elif measured.x is not None and time.size > 1:
        speed = slope(time, measured.x, settings.window)
    if speed is not None:
        yield "speed", ExportedChannel(speed, "m/s")
    if speed is not None and setup.wheel_radius is not None:
        turning = np.abs(omega) > settings.standing_share * np.abs(run.command.omega).max()
        rim = np.where(turning, setup.wheel_radius * omega, np.nan)
        yield "slip", ExportedChannel(1 - speed / rim, "1")
    if measured.fx is not None:
        load = measured.fz
        if load is None and setup.mass_z is not None:
            gravity = GRAVITY if setup.gravity is None else setup.gravity
            load = np.full_like(time, setup.mass_z * gravity)
        if load is not None:
            loaded = np.where(load == 0, np.nan, load)
            yield "drawbar_coefficient", ExportedChannel(measured.fx / loaded, "1")
    if measured.torque is not None:
        yield "power", ExportedChannel(measured.torque * omega, "W")


def _turned(run: RunLog, time: Reals) -> Reals:
    """Angle that the commanded speed turns from its first row on [rad], NaN outside its rows."""
    knots, omega = run.command.time, run.command.omega
    steps = np.diff(knots)
    at_knots = np.r_[0.0, np.cumsum(steps * (omega[1:] + omega[:-1]) / 2)]
    inside = (time >= knots[0]) & (time <= knots[-1])
    before = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, max(knots.size - 2, 0))
    past = time - knots[before]
    angle = at_knots[before] + past * (omega[before] + np.interp(time, knots, omega)) / 2
    return np.where(inside, angle, np.nan)


def slope(time: Reals, values: Reals, window: float) -> Reals:
    """Slope of the line through the samples within half a window of each.

    Args:
        time: Increasing times, at any intervals [s], shape (rows,).
        values: Samples, shape (rows,).
        window: Length of the window [s]; it holds the neighbours at the least.

    Returns:
        Slope at each sample [1/s], shape (rows,).
    """
    rows = np.arange(time.size)
    first = np.minimum(np.searchsorted(time, time - window / 2), np.maximum(rows - 1, 0))
    last = np.searchsorted(time, time + window / 2, side="right")
    last = np.maximum(last, np.minimum(rows + 2, time.size))
    # Sums over windows are differences of sums from the start; small numbers lose fewer digits.
    t, v = time - time.mean(), values - values.mean()
    sums = [np.r_[0.0, np.cumsum(each)] for each in (np.ones_like(t), t, v, t * t, t * v)]
    n, t1, v1, tt, tv = (each[last] - each[first] for each in sums)
    return (n * tv - t1 * v1) / (n * tt - t1 * t1)
