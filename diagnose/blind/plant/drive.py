"""The plant's drive: the wheel's speed over a run, worked out from what was commanded.

The sand does not slow the wheel down, so the whole course is known before the run.
"""

import abc
from dataclasses import dataclass

import numpy as np

from drftjax.physics.command import split_at_reversals

# Time between points of a course [s].
GRID = 2e-3


class AbstractPlantDrive(abc.ABC):
    """Turns a commanded speed [rad/s], `GRID` apart, into the wheel's."""

    @abc.abstractmethod
    def follow(self, commanded: np.ndarray) -> np.ndarray:
        """The wheel's speed at the same times."""


@dataclass(frozen=True)
class PlantSpeedGain(AbstractPlantDrive):
    """A ratio that is off by `gain`, and a `bend` of it less at full speed."""

    gain: float
    bend: float = 0.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        return commanded * (1 + self.gain * (1 - self.bend * np.abs(commanded) / 3.5))


@dataclass(frozen=True)
class PlantSpeedLag(AbstractPlantDrive):
    """A lag of second order; `lag` [s] is how late a ramp is, `damping` its shape."""

    lag: float
    damping: float = 1.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        if self.lag <= 0:
            return commanded
        natural = 2 * self.damping / self.lag
        # Implicit, so that any lag may be asked for.
        scale = 1 + 2 * self.damping * natural * GRID + (natural * GRID) ** 2
        speed, rate = float(commanded[0]), 0.0
        followed = np.empty_like(commanded)
        for index, asked in enumerate(commanded.tolist()):
            rate = (rate + GRID * natural**2 * (asked - speed)) / scale
            speed += GRID * rate
            followed[index] = speed
        return followed


@dataclass(frozen=True)
class PlantSpeedRipple(AbstractPlantDrive):
    """A ripple of two harmonics, locked to the wheel's angle."""

    amplitude: float
    order: float
    phase: float = 0.0
    second: float = 0.3
    second_phase: float = 0.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        angle, course = 0.0, np.empty_like(commanded)
        for index, asked in enumerate(commanded.tolist()):
            turned = self.order * (angle + 0.5 * GRID * asked)
            wave = np.cos(turned + self.phase)
            wave += self.second * np.cos(2 * turned + self.second_phase)
            course[index] = asked * (1 + self.amplitude * wave)
            angle += GRID * course[index]
        return course


@dataclass(frozen=True)
class PlantBacklash(AbstractPlantDrive):
    """The wheel stands until the drive has turned by `play` [rad] either way, and follows at once.

    A drive that turns back lets go of it, and has twice the play to cross.
    """

    play: float
    snap: float = 0.02

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        if self.play <= 0:
            return commanded
        course, within = np.empty_like(commanded), 0.0
        for part, sense in split_at_reversals(np.sign(commanded)):
            turned = np.cumsum(np.abs(commanded[part])) * GRID
            taken_up = int(np.searchsorted(turned, self.play - sense * within))
            since = (np.arange(len(turned)) - taken_up) * GRID
            course[part] = commanded[part] * np.clip(since / self.snap, 0, 1)
            # Where the drive stands in its play when it turns back.
            within = sense * min(sense * within + turned[-1], self.play)
        return course
