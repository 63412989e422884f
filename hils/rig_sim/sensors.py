"""Instruments of the virtual rig: noisy counts of the truth, and a clock of its own."""

import enum
import math

import msgspec
import numpy as np

from drftjax.common.arrays import require_between
from hils.rig_sim.faults import INT32, Counts
from hils.rig_sim.physics import RigMotion

# The scales are read this often [Hz]; between two readings their noise stays what it is.
SAMPLING_RATE = 1000.0


# Samples of noise that are drawn together.
BATCH = 1024


U32_SECONDS = 2**32 * 1e-6


class RandomStream(enum.IntEnum):
    """Chances of a rig that must not be the same numbers: beside its seed, what they are for."""

    NOISE = 1
    BED = 2
    BOOT = 3
    FAULT = 4


class Instruments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rig's scales.

    Attributes:
        z_scale, x_scale: Metres a count; x is not measured where its scale is 0.
        z_noise, x_noise: Standard deviation of a reading before it is rounded [m].
        omega_noise: Of the angular velocity as measured [rad/s].
    """

    z_scale: float = 1e-5
    x_scale: float = 2e-5
    z_noise: float = 2e-5
    x_noise: float = 2e-5
    omega_noise: float = 1e-3

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            InputError: says what was given and what must hold.
        """
        require_between("z_scale", self.z_scale, 1e-9, 1e-2, " m a count")
        if self.x_scale:
            require_between("x_scale", self.x_scale, 1e-9, 1e-2, " m a count, or be 0")
        for name in ("z_noise", "x_noise"):
            require_between(name, getattr(self, name), 0.0, 0.1, " m")
        require_between("omega_noise", self.omega_noise, 0.0, 10.0, " rad/s")

    def read(self, motion: RigMotion, zero: tuple[float, float], noise: np.ndarray) -> Counts:
        """Counts of what is.

        Args:
            motion: The truth.
            zero: Height and place that the scales counted from at power-up [m].
            noise: Three standard normal numbers.
        """
        z = (motion.z - zero[0] + self.z_noise * noise[0]) / self.z_scale
        x = 0.0
        if self.x_scale:
            x = (motion.x - zero[1] + self.x_noise * noise[1]) / self.x_scale
        omega = motion.omega + self.omega_noise * noise[2]
        return Counts(_counted(z), _counted(x), float(omega))


def _counted(value: float) -> int:
    return max(-INT32, min(INT32, round(value))) if math.isfinite(value) else INT32


class SensorNoise:
    """Standard normal numbers for every sample of a run: the same, whoever asks and how often.

    Args:
        seed: Of the numbers.
        channels: How many numbers a sample has.
    """

    def __init__(self, seed: int, channels: int = 3):
        self._seed, self._channels = seed, channels
        self._batch, self._numbers = -1, np.zeros((BATCH, channels))

    def at(self, time: float) -> np.ndarray:
        """The numbers of the sample at this time [s], shape (channels,)."""
        batch, place = divmod(max(math.floor(time * SAMPLING_RATE + 1e-6), 0), BATCH)
        if batch != self._batch:
            random = np.random.default_rng([self._seed, RandomStream.NOISE, batch])
            self._batch, self._numbers = batch, random.standard_normal((BATCH, self._channels))
        return self._numbers[place]


class RigClock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The firmware's own clock.

    Attributes:
        skew: How much faster it runs than the host's [-]: 50e-6 is a usual crystal.
        ahead: Its reading at power-up [s]; the wire's clock wraps at 4294.967296 s.
    """

    skew: float = 50e-6
    ahead: float = U32_SECONDS - 5.0

    def check(self) -> None:
        """Refuse what cannot be.

        Raises:
            InputError: says what was given and what must hold.
        """
        require_between("clock skew", self.skew, -0.1, 0.1)
        require_between("clock at power-up", self.ahead, 0.0, 1e6, " s")

    def reading(self, since: float) -> float:
        """Its reading [s] so long after power-up by the host's clock [s]."""
        return self.ahead + (1 + self.skew) * since

    def since(self, reading: float) -> float:
        """Host's time after power-up [s] at which it reads so [s]."""
        return (reading - self.ahead) / (1 + self.skew)
