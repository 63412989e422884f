"""Commands and loads of the runs of a set: nine to diagnose by, three fresh ones to test it on."""

from dataclasses import dataclass, replace

import numpy as np

from diagnose.blind.plant.rig import DEFAULT_RIG, PlantRig
from diagnose.next_runs.recommended_runs import RECOMMENDED_RUNS as RIG_RUNS

RUN_LETTERS = "abcdefghi"
STANDARD_MASS = DEFAULT_RIG.mass_z  # [kg]
WHEEL_RADIUS = DEFAULT_RIG.radius  # [m]

Range = tuple[float, float]


@dataclass(frozen=True)
class PlannedRun:
    """Commanded speed, linear between its knots, and the load of a run.

    Attributes:
        time: Times of the knots, in whole hundredths, from zero [s].
        speed: Wheel speed at the knots, negative backward [deg/s].
        mass: Vertical mass, as the experimenter believes it [kg].
        carriage: Carriage speed at the knots [m/s], where it is driven; none otherwise.
        logged_from: Time from which on the run is logged [s].
    """

    time: tuple[float, ...]
    speed: tuple[float, ...]
    mass: float = STANDARD_MASS
    carriage: tuple[float, ...] = ()
    logged_from: float = 0.0

    @classmethod
    def held(
        cls,
        speed: float,
        rise: float,
        hold: float,
        fall: float,
        rest: float = 2.0,
        end: float = 2.0,
        mass: float = STANDARD_MASS,
    ) -> "PlannedRun":
        """Trapezoid: the wheel rests, speeds up, holds its speed, slows down and rests.

        Args:
            speed: Held speed [deg/s].
            rise, hold, fall: Durations of the ramps and of the held speed [s].
            rest, end: Durations of the rests before and after [s].
            mass: Vertical mass [kg].
        """
        times = np.cumsum([0.0, rest, rise, hold, fall, end])
        return cls(tuple(map(float, times)), (0.0, 0.0, speed, speed, 0.0, 0.0), mass)

    @property
    def duration(self) -> float:
        """Duration of the run [s]."""
        return self.time[-1]

    @property
    def rest(self) -> float:
        """Duration of the rest before the wheel is first turned [s]."""
        return self.time[1]

    def omega(self, time: np.ndarray) -> np.ndarray:
        """Commanded speed at these times [s], of the same shape [rad/s]."""
        return np.interp(time, self.time, np.radians(self.speed))

    def carriage_speed(self, time: np.ndarray) -> np.ndarray:
        """Commanded carriage speed at these times [s], of the same shape [m/s]."""
        return np.interp(time, self.time, self.carriage) if self.carriage else np.zeros_like(time)

    def on(self, rig: PlantRig) -> "PlannedRun":
        """The same run with the load in proportion to that of another rig."""
        return replace(self, mass=round(self.mass * rig.force_scale, 3))


@dataclass(frozen=True)
class RandomRunSettings:
    """Ranges that the speeds, ramps, durations and loads of random runs are drawn from.

    Attributes:
        repeated_speed: Speed of the run that is made twice [deg/s].
        other_speeds: Speeds of the other runs with the standard mass [deg/s].
        light_speed, light_mass: Speed [deg/s] and mass [kg] of the lighter run.
        heavy_speed, heavy_mass: Speed [deg/s] and mass [kg] of the heavier run.
        fast_speed: Speed of the fastest run [deg/s].
        fresh_speeds: Speeds of the fresh runs with the standard mass [deg/s].
        fresh_loaded_speed, fresh_mass: Speed [deg/s] and mass [kg] of the third fresh run.
        ramp, fast_ramp: Acceleration of ramps, and of those of the fastest run [deg/s2]. Ramps are
            gentle but for that run, as each step costs the same.
        ramp_time: Least and greatest duration of a ramp [s].
        hold: Duration at the held speed [s].
        min_hold: Least duration at the held speed [s].
        motion: Least and greatest duration of the motion, ramps included [s]. With the rests, a run
            takes 24 s at most, for which the plant's program has room.
        max_travel: Greatest travel of a wheel without slip [m]: a rail goes no farther.
    """

    repeated_speed: Range = (25, 40)
    other_speeds: tuple[Range, ...] = ((10, 25), (40, 80), (60, 120), (30, 60))
    light_speed: Range = (20, 45)
    light_mass: Range = (13, 16)
    heavy_speed: Range = (30, 80)
    heavy_mass: Range = (21, 25)
    fast_speed: Range = (120, 200)
    fresh_speeds: tuple[Range, Range] = ((20, 35), (50, 110))
    fresh_loaded_speed: Range = (25, 90)
    fresh_mass: Range = (15, 22)
    ramp: Range = (8.0, 30.0)
    fast_ramp: Range = (60.0, 100.0)
    ramp_time: Range = (1.0, 5.0)
    hold: Range = (3.0, 12.0)
    min_hold: float = 1.0
    motion: Range = (4.0, 20.0)
    max_travel: float = 2.0


DEFAULT_RANDOM_RUNS = RandomRunSettings()


_PAPER_RUN = PlannedRun.held(30.0, 5.0, 10.0, 5.0)

PRACTICE_RUNS = (
    _PAPER_RUN,
    _PAPER_RUN,
    PlannedRun.held(15.0, 5.0, 10.0, 5.0),
    PlannedRun.held(60.0, 4.0, 6.0, 4.0),
    PlannedRun.held(90.0, 3.0, 4.0, 3.0),
    PlannedRun.held(45.0, 1.0, 8.0, 1.0),
    PlannedRun.held(30.0, 5.0, 10.0, 5.0, mass=14.0),
    PlannedRun.held(60.0, 2.0, 5.0, 2.0, mass=23.0),
    PlannedRun.held(200.0, 2.0, 2.0, 2.0),
)

RECOMMENDED_RUNS = tuple(
    PlannedRun(run.time, run.speed, round(STANDARD_MASS * run.load, 3)) for run in RIG_RUNS
)


def _draw_run(
    random: np.random.Generator, speeds: Range, ramps: Range, settings: RandomRunSettings
) -> PlannedRun:
    speed = float(np.round(np.exp(random.uniform(np.log(speeds[0]), np.log(speeds[1])))))
    rise, fall = (
        float(np.round(each, 1))
        for each in np.clip(speed / random.uniform(*ramps, 2), *settings.ramp_time)
    )
    on_the_rail = settings.max_travel / (np.radians(speed) * WHEEL_RADIUS) - (rise + fall) / 2
    shortest, longest = settings.motion
    hold = min(random.uniform(*settings.hold), longest - rise - fall, on_the_rail)
    hold = float(np.round(max(hold, shortest - rise - fall, settings.min_hold), 1))
    return PlannedRun.held(speed, rise, hold, fall)


def _draw_loaded_run(
    random: np.random.Generator, speeds: Range, masses: Range, settings: RandomRunSettings
) -> PlannedRun:
    run = _draw_run(random, speeds, settings.ramp, settings)
    return replace(run, mass=round(random.uniform(*masses), 3))


def draw_nine_runs(
    random: np.random.Generator, settings: RandomRunSettings = DEFAULT_RANDOM_RUNS
) -> tuple[PlannedRun, ...]:
    """Draw nine runs: a repeated one, four others and a fast one, a lighter and a heavier one."""
    first = _draw_run(random, settings.repeated_speed, settings.ramp, settings)
    others = [_draw_run(random, band, settings.ramp, settings) for band in settings.other_speeds]
    light = _draw_loaded_run(random, settings.light_speed, settings.light_mass, settings)
    heavy = _draw_loaded_run(random, settings.heavy_speed, settings.heavy_mass, settings)
    fast = _draw_run(random, settings.fast_speed, settings.fast_ramp, settings)
    return (first, first, *others, light, heavy, fast)


def draw_fresh_runs(
    random: np.random.Generator, settings: RandomRunSettings = DEFAULT_RANDOM_RUNS
) -> tuple[PlannedRun, ...]:
    """Draw three runs that repeat none of the nine."""
    loaded = _draw_loaded_run(random, settings.fresh_loaded_speed, settings.fresh_mass, settings)
    slow, fast = (
        _draw_run(random, speeds, settings.ramp, settings) for speeds in settings.fresh_speeds
    )
    return slow, fast, loaded


@dataclass(frozen=True)
class SweepSettings:
    """Runs of a sweep over slip with a driven carriage.

    Attributes:
        slips: Slip ratios of the runs that are made twice [-].
        fast_slips: Slip ratios of the faster runs [-].
        omega: Least and greatest angular velocity of the default rig [rad/s]; other rigs' goes with
            the root of gravity over their radius.
        fast_ratio: Angular velocity of the faster runs over that of the others [-].
        rest, ramp: Durations of the rest and of the ramp before a run is steady [s].
        settling: Time after the ramp before the run is logged [s].
        logged: Time logged [s].
    """

    slips: tuple[float, ...] = (0.0, 0.15, 0.3, 0.45, 0.6)
    fast_slips: tuple[float, ...] = (0.15, 0.45)
    omega: Range = (0.3, 0.55)
    fast_ratio: float = 3.0
    rest: float = 0.5
    ramp: float = 1.5
    settling: float = 2.0
    logged: float = 6.0


DEFAULT_SWEEP = SweepSettings()


def draw_sweep(
    random: np.random.Generator, rig: PlantRig, settings: SweepSettings = DEFAULT_SWEEP
) -> dict[str, PlannedRun]:
    """Draw the runs of a sweep, by name: each slip twice, and the faster ones."""
    omega = float(random.uniform(*settings.omega)) / rig.length_scale**0.5

    def run(omega: float, slip: float) -> PlannedRun:
        speed, carriage = float(np.degrees(omega)), (1 - slip) * rig.radius * omega
        start = settings.rest + settings.ramp
        logged_from = start + settings.settling
        return PlannedRun(
            time=(0.0, settings.rest, start, logged_from + settings.logged),
            speed=(0.0, 0.0, speed, speed),
            mass=rig.mass_z,
            carriage=(0.0, 0.0, carriage, carriage),
            logged_from=logged_from,
        )

    runs = {
        f"slip{round(100 * slip):02d}{letter}": run(omega, slip)
        for slip in settings.slips
        for letter in "ab"
    }
    fast = settings.fast_ratio * omega
    return runs | {f"fast{round(100 * slip):02d}": run(fast, slip) for slip in settings.fast_slips}
