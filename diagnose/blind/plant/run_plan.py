"""What a set's runs are asked: nine to diagnose by, three fresh ones to hold the answer against."""

from dataclasses import dataclass, replace

import numpy as np

from diagnose.next_runs.recommended_runs import RECOMMENDED_RUNS
from drftjax.physics.integrator import steady_step

LETTERS = "abcdefghi"


STANDARD_MASS = 18.837


WHEEL_RADIUS = 0.150


@dataclass(frozen=True)
class PlannedRun:
    """A commanded speed, linear between its knots, and the load it is run with.

    Attributes:
        time: Of the knots [s], in whole hundredths, from zero.
        speed: At the knots [deg/s], negative backward.
        mass: Believed vertical mass [kg].
    """

    time: tuple[float, ...]
    speed: tuple[float, ...]
    mass: float = STANDARD_MASS

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
        """A wheel that stands, speeds up, holds its speed, slows down and stands [s], [deg/s]."""
        lasts = np.cumsum([0.0, rest, rise, hold, fall, end])
        return cls(tuple(map(float, lasts)), (0.0, 0.0, speed, speed, 0.0, 0.0), mass)

    @property
    def duration(self) -> float:
        return self.time[-1]

    @property
    def rest(self) -> float:
        """How long the wheel stands before it is first turned [s]."""
        return self.time[1]

    def omega(self, time: np.ndarray) -> np.ndarray:
        """Commanded speed [rad/s] at these times [s]."""
        return np.interp(time, self.time, np.radians(self.speed))

    def steady_step(self) -> float:
        """The longest step [s] that a fit would choose."""
        return steady_step(WHEEL_RADIUS, np.array(self.time), np.radians(self.speed))


_PAPER = PlannedRun.held(30.0, 5.0, 10.0, 5.0)


PRACTICE = (
    _PAPER,
    _PAPER,
    PlannedRun.held(15.0, 5.0, 10.0, 5.0),
    PlannedRun.held(60.0, 4.0, 6.0, 4.0),
    PlannedRun.held(90.0, 3.0, 4.0, 3.0),
    PlannedRun.held(45.0, 1.0, 8.0, 1.0),
    PlannedRun.held(30.0, 5.0, 10.0, 5.0, mass=14.0),
    PlannedRun.held(60.0, 2.0, 5.0, 2.0, mass=23.0),
    PlannedRun.held(200.0, 2.0, 2.0, 2.0),
)


TELLING = tuple(
    PlannedRun(r.time, r.speed, round(STANDARD_MASS * r.load, 3)) for r in RECOMMENDED_RUNS
)


def _drawn(
    random: np.random.Generator,
    slowest: float,
    fastest: float,
    ramp: tuple[float, float] = (8.0, 30.0),
) -> PlannedRun:
    speed = float(np.round(np.exp(random.uniform(np.log(slowest), np.log(fastest)))))
    # Ramps [deg/s2] are gentle but for the fastest run, as each step costs the same.
    rise, fall = (
        float(np.round(each, 1)) for each in np.clip(speed / random.uniform(*ramp, 2), 1.0, 5.0)
    )
    # Two metres are as far as a rail goes, and 24 s as long as a run.
    farthest = 2.0 / (np.radians(speed) * WHEEL_RADIUS) - (rise + fall) / 2
    longest = min(random.uniform(3.0, 12.0), 20.0 - rise - fall, farthest)
    hold = float(np.round(max(longest, 4.0 - rise - fall, 1.0), 1))
    return PlannedRun.held(speed, rise, hold, fall)


def draw_nine_runs(random: np.random.Generator) -> tuple[PlannedRun, ...]:
    """Nine runs by lot: a repeated one, six at its mass, one lighter and one heavier."""
    first = _drawn(random, 25, 40)
    others = [_drawn(random, *band) for band in ((10, 25), (40, 80), (60, 120), (30, 60))]
    light = replace(_drawn(random, 20, 45), mass=round(random.uniform(13, 16), 3))
    heavy = replace(_drawn(random, 30, 80), mass=round(random.uniform(21, 25), 3))
    fast = _drawn(random, 120, 200, (60.0, 100.0))
    return (first, first, *others, light, heavy, fast)


def draw_fresh_runs(random: np.random.Generator) -> tuple[PlannedRun, ...]:
    """Three runs that none of the nine repeats."""
    other = replace(_drawn(random, 25, 90), mass=round(random.uniform(15, 22), 3))
    return _drawn(random, 20, 35), _drawn(random, 50, 110), other
