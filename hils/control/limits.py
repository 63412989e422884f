"""Plausibility limits of measurements and saturation limits of commands, as pure functions.

The loop keeps the state, so a replay of a run judges the same readings in the same way.
"""

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError


@dataclass(frozen=True)
class SensorMotionSettings:
    """Motion that must show in a sensor; without it a sensor that stands still is not stuck.

    Attributes:
        min_omega: A wheel that turns slower need not show it in its height [rad/s].
        min_vx: A carriage that is driven slower need not show it in its travel [m/s].
    """

    min_omega: float = 0.05
    min_vx: float = 5e-3


DEFAULT_SENSOR_MOTION = SensorMotionSettings()


class Reading(NamedTuple):
    """A measurement in metres, zeroed at touch-down.

    Attributes:
        time: When it arrived, from the run's start [s].
        x: Forward travel [m]; NaN where the rig does not measure it.
        z: Height [m], minus the sinkage.
        omega: Angular velocity as measured [rad/s]; NaN where the rig does not measure it.
    """

    time: float
    x: float
    z: float
    omega: float


class ReadingLimits(msgspec.Struct, frozen=True):
    """Limits within which a reading is used.

    Attributes:
        highest: Height over touch-down [m].
        lowest: Height at the deepest sinkage that the wheel's plates cover [m].
        fastest: Vertical speed [m/s].
        slack: Change of the height that is allowed at any time [m].
        fastest_x: Speed of the carriage [m/s].
        slack_x: Change of the travel that is allowed at any time [m].
        in_a_row: Readings refused one after the other that end the run.
        still: Time without any change, while the wheel turns (of x: while the carriage is driven),
            after which the sensor counts as stuck [s].
        drive_error: Difference of measured and commanded angular velocity that is no noise [rad/s].
        drive_time: Time over which that difference lasts before it is flagged [s].
        noisy_at_rest: True where the readings of the standing wheel showed noise, so that a height
            without any change means a stuck sensor, and `still` may be short.
    """

    highest: float = 0.05
    lowest: float = -0.065
    fastest: float = 0.1
    slack: float = 2e-3
    fastest_x: float = 100.0
    slack_x: float = 0.02
    in_a_row: int = 5
    still: float = 1.0
    drive_error: float = 0.05
    drive_time: float = 0.5
    noisy_at_rest: bool = False

    def by_noise(self, repeated: float, interval: float) -> "ReadingLimits":
        """The limits with the time after which z is stuck taken from the noise at rest.

        A run of equal readings as long as that has a chance of one in 1e9 while the sensor lives,
        but no less than a tenth of a second is taken.

        Args:
            repeated: Share of the standing wheel's readings that equal the one before [-].
            interval: From one reading to the next [s].
        """
        if not repeated < _MOST_REPEATED:
            return self
        count = math.log(_CHANCE) / math.log(max(repeated, _CHANCE))
        still = max(_SHORTEST_STILL, (count + 1) * interval)
        return msgspec.structs.replace(self, still=min(self.still, still), noisy_at_rest=True)


# A sensor that repeats more of its readings than this at rest shows too little noise to judge by.
_MOST_REPEATED = 0.9
_CHANCE, _SHORTEST_STILL = 1e-9, 0.1  # [-], [s]


class Verdict(enum.Enum):
    """Judgement of a reading; the value is its wording for a person."""

    USED = "used"
    OUTSIDE = "outside of what the wheel can do"
    JUMP = "a jump"
    JUMP_OF_X = "a jump of x"


class ReadingMonitor(NamedTuple):
    """Memory of the readings, from one to the next.

    Attributes:
        time, z: Of the last reading that was used [s], [m].
        refused: Readings refused since.
        seen: The last height read, whatever became of it [m].
        still_since: Since when it has not changed, or the wheel has not turned [s].
        apart_since: Since when the wheel does not turn as commanded [s]; NaN where it does.
        stuck: True where the sensor counts as stuck.
        drive_off: True where the drive counts as not following.
        x: Of the last reading that was used [m]; NaN before the first.
        x_seen: The last travel read, whatever became of it [m].
        x_still_since: Since when it has not changed, or the carriage has not been driven [s].
        x_stuck: True where x counts as stuck: its sensor, or the carriage.
    """

    time: float
    z: float
    refused: int = 0
    seen: float = math.nan
    still_since: float = 0.0
    apart_since: float = math.nan
    stuck: bool = False
    drive_off: bool = False
    x: float = math.nan
    x_seen: float = math.nan
    x_still_since: float = 0.0
    x_stuck: bool = False


def check_reading(
    limits: ReadingLimits,
    watch: ReadingMonitor,
    reading: Reading,
    omega: float,
    vx: float = 0.0,
    motion: SensorMotionSettings = DEFAULT_SENSOR_MOTION,
) -> tuple[ReadingMonitor, Verdict]:
    """Judge a reading: outside of the limits, a jump, or used.

    A jump is a change of the height of more than slack + fastest * dt since the last reading used,
    dt before it; of the travel likewise.

    Args:
        limits: Of a reading.
        watch: Memory of the readings before.
        reading: The reading, newer than any before.
        omega: Angular velocity commanded when it was made [rad/s].
        vx: Speed that the carriage was driven at then [m/s]; zero where it is free.
        motion: Motion that must show in a sensor.

    Returns:
        The memory with this reading in it, and the judgement.
    """
    verdict = _verdict(limits, watch, reading)
    time = reading.time
    # A wheel in the air need not show that it turns.
    in_air = reading.z >= 0
    changed = reading.z != watch.seen or abs(omega) < motion.min_omega or in_air
    still_since = time if changed else watch.still_since
    x_changed = reading.x != watch.x_seen or abs(vx) < motion.min_vx
    x_still_since = time if x_changed else watch.x_still_since
    differs = abs(reading.omega - omega) > limits.drive_error  # False where it is NaN
    apart_since = math.nan
    if differs:
        apart_since = time if math.isnan(watch.apart_since) else watch.apart_since
    after = ReadingMonitor(
        time if verdict is Verdict.USED else watch.time,
        reading.z if verdict is Verdict.USED else watch.z,
        0 if verdict is Verdict.USED else watch.refused + 1,
        reading.z,
        still_since,
        apart_since,
        time - still_since > limits.still,
        differs and time - apart_since > limits.drive_time,
        reading.x if verdict is Verdict.USED else watch.x,
        reading.x,
        x_still_since,
        time - x_still_since > limits.still,
    )
    return after, verdict


def _verdict(limits: ReadingLimits, watch: ReadingMonitor, reading: Reading) -> Verdict:
    if not limits.lowest <= reading.z <= limits.highest:  # so that NaN is refused too
        return Verdict.OUTSIDE
    since = max(reading.time - watch.time, 0.0)
    if not abs(reading.z - watch.z) <= limits.slack + limits.fastest * since:
        return Verdict.JUMP
    # NaN, where x is not measured or was not read before, is no jump.
    if abs(reading.x - watch.x) > limits.slack_x + limits.fastest_x * since:
        return Verdict.JUMP_OF_X
    return Verdict.USED


class RigCommand(NamedTuple):
    """Command to the rig: angular velocity [rad/s] and carriage speed [m/s]."""

    omega: float
    vx: float


REST = RigCommand(0.0, 0.0)


class CommandLimits(msgspec.Struct, frozen=True):
    """Limits of commands, beside those that the rig holds itself.

    Attributes:
        omega: Angular velocity [rad/s].
        vx: Carriage speed [m/s].
        omega_slew: Change of the angular velocity [rad/s2].
        vx_slew: Change of the carriage speed [m/s2].
    """

    omega: float
    vx: float
    omega_slew: float = 5.0
    vx_slew: float = 1.0


def limit_command(
    limits: CommandLimits, before: RigCommand, asked: RigCommand, duration: float
) -> tuple[RigCommand, bool] | None:
    """Hold a command to the slew limits.

    Args:
        limits: Of commands.
        before: The demand before it.
        asked: The demand that the simulation and the profile give.
        duration: Time from the one to the other [s].

    Returns:
        The command, and True where it was held back; None where it is refused.
    """
    if not (abs(asked.omega) <= limits.omega and abs(asked.vx) <= limits.vx):
        return None
    omega = _slew(before.omega, asked.omega, limits.omega_slew * duration)
    vx = _slew(before.vx, asked.vx, limits.vx_slew * duration)
    held = RigCommand(omega, vx)
    return held, held != asked


def _slew(before: float, asked: float, most: float) -> float:
    return asked if abs(asked - before) <= most else before + math.copysign(most, asked - before)


def require_profile(
    time: NDArray[np.float64], omega: NDArray[np.float64], limits: CommandLimits, who: str
) -> None:
    """Refuse a profile that cannot be commanded, before anything moves.

    Args:
        time, omega: Knots of the profile [s], [rad/s].
        limits: Of commands.
        who: Whose limits they are, for the sentence.

    Raises:
        InputError: a knot breaks a limit, or the profile does not start at rest.
    """
    fastest = int(np.argmax(np.abs(omega)))
    if abs(omega[fastest]) > limits.omega:
        raise InputError(
            f"the profile asks for {omega[fastest]:.4g} rad/s at {time[fastest]:g} s, "
            f"{who} allows {limits.omega:.4g} rad/s at most"
        )
    if omega[0] != 0:
        raise InputError(
            f"the profile starts with {omega[0]:.4g} rad/s at {time[0]:g} s, it must start at rest"
        )
    slopes = np.abs(np.diff(omega) / np.diff(time))
    steepest = int(np.argmax(slopes))
    if slopes[steepest] > limits.omega_slew:
        raise InputError(
            f"the profile changes by {slopes[steepest]:.4g} rad/s2 after {time[steepest]:g} s, "
            f"{limits.omega_slew:.4g} rad/s2 are allowed at most"
        )
