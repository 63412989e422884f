"""Nine recommended runs, from which a diagnosis can tell most effects apart.

Forward runs with gentle ramps leave some effects alike: a carriage that never goes backward cannot
tell its friction from a pull, and one that never stops sharply cannot tell a late reading from a
filtered one. These nine go backward once, stop and go once, and are fastest at two loads, as the
momentum of the sand weighs less under a heavy wheel and its lost height does not.
"""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drftjax.common.arrays import require_between
from drftjax.common.errors import InputError
from drftjax.setups.setup import CommandSetUp, SetUp, StartSetUp
from drftjax.setups.terrain_setup import ZetaKnots
from drftjax.simulation.statics import standing_sinkage

LIGHT_LOAD, HEAVY_LOAD = 0.75, 1.25
"""Loads of the lightest and the heaviest run, as shares of the rig's own [-]."""


@dataclass(frozen=True)
class RecommendedRunSettings:
    """Rounding and limits of the commands.

    Attributes:
        min_hold: A run that is too long for its rail holds its speed for so long at least [s].
        time_step: Times are multiples of this [s],
        speed_step: and speeds of this [deg/s].
        rounding: Part of `speed_step` by which a speed may lie under a multiple and still be one.
    """

    min_hold: float = 0.5
    time_step: float = 0.01
    speed_step: float = 0.1
    rounding: float = 1e-6


DEFAULT_RECOMMENDED_RUNS = RecommendedRunSettings()


@dataclass(frozen=True)
class RecommendedRun:
    """Command and load of one recommended run.

    Attributes:
        name: The run, in a word or two.
        tells: Purpose of the run.
        time: Knots of its command [s].
        speed: Wheel speed at the knots, linear in between, negative backward [deg/s].
        load: Vertical mass as a share of the rig's own.
    """

    name: str
    tells: str
    time: tuple[float, ...]
    speed: tuple[float, ...]
    load: float = 1.0


def _held(
    name: str, tells: str, speed: float, rise: float, hold: float, load: float = 1.0
) -> RecommendedRun:
    time = np.cumsum([0.0, 2.0, rise, hold, rise, 2.0])
    return RecommendedRun(
        name, tells, tuple(map(float, time)), (0.0, 0.0, speed, speed, 0.0, 0.0), load
    )


def _stop_and_go(name: str, tells: str, speed: float, ramp: float, held: float) -> RecommendedRun:
    parts = [0.0, held, *(3 * [ramp, held, ramp, held])]
    time = tuple(round(float(each), 3) for each in np.cumsum(parts))
    return RecommendedRun(name, tells, time, (0.0, 0.0, *(3 * [speed, speed, 0.0, 0.0])))


RECOMMENDED_RUNS = (
    _held("paper", "the paper's run, the one that others are held against", 30.0, 5.0, 10.0),
    _held("again", "the same again: noise floor, and how far zeta scatters", 30.0, 5.0, 10.0),
    _held("backward", "a pull, a slope or a spring from friction", -60.0, 4.0, 6.0),
    _stop_and_go("stop_and_go", "late, slow and filtered readings; backlash", 45.0, 0.25, 0.5),
    _held("swift", "what grows with speed, over a long travel", 90.0, 3.0, 4.0),
    _held("light", "loads from readings", 30.0, 5.0, 10.0, LIGHT_LOAD),
    _held("heavy", "how stress grows with depth", 60.0, 2.0, 5.0, HEAVY_LOAD),
    _held("fast_light", "momentum of the sand from its lost height", 200.0, 2.0, 2.0, LIGHT_LOAD),
    _held("fast_heavy", "the same, under more load", 200.0, 2.0, 2.0, HEAVY_LOAD),
)


def recommended_runs(
    like: SetUp,
    max_speed: float | None = None,
    max_travel: float | None = None,
    settings: RecommendedRunSettings = DEFAULT_RECOMMENDED_RUNS,
) -> Iterator[tuple[RecommendedRun, SetUp]]:
    """The nine runs for a rig, each with its set-up.

    Args:
        like: Set-up of the rig: wheel, sand and loads; its start and command are not used.
        max_speed: Largest speed of the wheel [deg/s]; faster runs are slowed down to it.
        max_travel: Longest travel of the carriage [m]; longer runs hold their speed for less long.
        settings: Rounding and limits of the commands.

    Raises:
        InputError: where the carriage is driven, a limit leaves no run, or the sand does not bear
            the wheel.
    """
    if like.rig.carriage != "free":
        raise InputError("the carriage of the rig is driven; these runs are of one that is free")
    if max_speed is not None:
        require_between("the largest speed", max_speed, 1.0, 3000.0, " deg/s")
    if max_travel is not None:
        require_between("the largest travel", max_travel, 0.01, 1000.0, " m")
    for run in RECOMMENDED_RUNS:
        setup = copy.deepcopy(like)
        time, speed = _within(run, like.wheel.radius, max_speed, max_travel, settings)
        setup.command = CommandSetUp(time, speed, omega_unit="deg/s")
        setup.title = f"{run.name}: {run.tells}"
        setup.rig.mass_z = round(like.rig.mass_z * run.load, 3)
        setup.start = StartSetUp()
        setup.start.sinkage = _standing_sinkage(setup)
        yield run, setup


def _within(
    run: RecommendedRun,
    radius: float,
    max_speed: float | None,
    max_travel: float | None,
    settings: RecommendedRunSettings,
) -> tuple[list[float], list[float]]:
    """Knots [s] and speeds [deg/s] inside the limits: held for less long first, then slower."""
    time, speed = np.array(run.time), np.array(run.speed)
    if max_speed is not None:
        speed *= min(1.0, max_speed / np.abs(speed).max())
    if max_travel is not None:
        step = settings.time_step
        farthest = np.degrees(max_travel / radius)
        top = np.abs(speed).max()
        held = np.diff(time) * (np.abs(speed[1:]) == top) * (np.abs(speed[:-1]) == top)
        longest = int(np.argmax(held))
        excess = math.ceil(max(0.0, _turned(time, speed) - farthest) / top / step) * step
        time[longest + 1 :] -= min(excess, max(0.0, held[longest] - settings.min_hold))
        speed *= min(1.0, farthest / _turned(time, speed))
    # Towards rest, so that no rounding passes a limit.
    steps = speed / settings.speed_step
    speed = np.trunc(steps + np.sign(steps) * settings.rounding) * settings.speed_step
    return np.round(time, 2).tolist(), np.round(speed, 1).tolist()


def _turned(time: np.ndarray, speed: np.ndarray) -> float:
    """Angle turned in both directions [deg]."""
    return float(np.trapezoid(np.abs(speed), time))


def _standing_sinkage(setup: SetUp) -> float:
    """Sinkage at which the wheel stands under this load [m]."""
    zeta = setup.terrain.zeta
    first = zeta.value[0] if isinstance(zeta, ZetaKnots) else zeta
    return round(standing_sinkage(setup.trial().simulator, first), 5)
