"""Drive of the plant: the wheel speed of a run, computed from the commanded speed.

The sand does not slow the wheel down, so the wheel speed is known before the run is simulated.
"""

import abc
from dataclasses import dataclass

import numpy as np

from drftjax.physics.command import split_at_reversals

# Sample interval of commanded and wheel speed [s].
SPEED_INTERVAL = 2e-3


class AbstractPlantDrive(abc.ABC):
    """Turns a commanded speed into the speed of the wheel."""

    @abc.abstractmethod
    def follow(self, commanded: np.ndarray) -> np.ndarray:
        """Wheel speed for a commanded speed.

        Args:
            commanded: Commanded speed every `SPEED_INTERVAL`, shape (times,) [rad/s].

        Returns:
            Wheel speed at the same times, shape (times,) [rad/s].
        """


@dataclass(frozen=True)
class PlantSpeedGain(AbstractPlantDrive):
    """Speed ratio with a relative error that decreases with speed.

    Attributes:
        gain: Relative error at standstill [-].
        bend: Share of the error that is gone at 3.5 rad/s [-].
    """

    gain: float
    bend: float = 0.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        return commanded * (1 + self.gain * (1 - self.bend * np.abs(commanded) / 3.5))


@dataclass(frozen=True)
class PlantSpeedLag(AbstractPlantDrive):
    """Lag of second order.

    Attributes:
        lag: Delay of a ramp [s].
        damping: Damping ratio [-].
    """

    lag: float
    damping: float = 1.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        if self.lag <= 0:
            return commanded
        natural = 2 * self.damping / self.lag
        # Implicit Euler, stable for any lag.
        scale = 1 + 2 * self.damping * natural * SPEED_INTERVAL + (natural * SPEED_INTERVAL) ** 2
        speed, rate = float(commanded[0]), 0.0
        speeds = np.empty_like(commanded)
        for index, target in enumerate(commanded.tolist()):
            rate = (rate + SPEED_INTERVAL * natural**2 * (target - speed)) / scale
            speed += SPEED_INTERVAL * rate
            speeds[index] = speed
        return speeds


@dataclass(frozen=True)
class PlantSpeedRipple(AbstractPlantDrive):
    """Ripple of two harmonics of the wheel angle.

    Attributes:
        amplitude: Relative amplitude of the first harmonic [-].
        order: Cycles of the first harmonic per turn [-].
        phase: Phase of the first harmonic [rad].
        second: Amplitude of the second harmonic relative to the first [-].
        second_phase: Phase of the second harmonic [rad].
    """

    amplitude: float
    order: float
    phase: float = 0.0
    second: float = 0.3
    second_phase: float = 0.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        angle, speeds = 0.0, np.empty_like(commanded)
        for index, target in enumerate(commanded.tolist()):
            cycle = self.order * (angle + 0.5 * SPEED_INTERVAL * target)
            wave = np.cos(cycle + self.phase)
            wave += self.second * np.cos(2 * cycle + self.second_phase)
            speeds[index] = target * (1 + self.amplitude * wave)
            angle += SPEED_INTERVAL * speeds[index]
        return speeds


@dataclass(frozen=True)
class PlantBacklash(AbstractPlantDrive):
    """Backlash: the wheel stands until the drive has turned through the play, then follows.

    The drive starts in the middle of its play, so that a first turn crosses `play` and a reversal
    twice as much.

    Attributes:
        play: Half of the whole play [rad].
        snap: Time in which the wheel takes up the speed of the drive [s].
    """

    play: float
    snap: float = 0.02

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        if self.play <= 0:
            return commanded
        speeds, position = np.empty_like(commanded), 0.0
        for part, sense in split_at_reversals(np.sign(commanded)):
            angle = np.cumsum(np.abs(commanded[part])) * SPEED_INTERVAL
            contact = int(np.searchsorted(angle, self.play - sense * position))
            since_contact = (np.arange(len(angle)) - contact) * SPEED_INTERVAL
            speeds[part] = commanded[part] * np.clip(since_contact / self.snap, 0, 1)
            # Position of the drive within its play when it turns back.
            position = sense * min(sense * position + angle[-1], self.play)
        return speeds


@dataclass(frozen=True)
class PlantCarriageGain:
    """Speed ratio of a driven carriage with a relative error that changes with speed.

    Attributes:
        gain: Relative error at standstill [-].
        bend: Relative growth of the error at 0.2 m/s [-].
    """

    gain: float
    bend: float = 0.0

    def follow(self, commanded: np.ndarray) -> np.ndarray:
        """Speed of the carriage for a commanded one, shape (times,) [m/s]."""
        return commanded * (1 + self.gain * (1 + self.bend * np.abs(commanded) / 0.2))
