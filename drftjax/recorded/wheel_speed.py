"""Measured speed of a wheel: beside the commanded one, and as what drives a run in its place."""

from dataclasses import dataclass, replace

import numpy as np

from drftjax.common.arrays import as_real
from drftjax.recorded.observation import white_noise
from drftjax.runlog.record import RunLog
from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class WheelSpeedSettings:
    """Numbers that decide whether a measured speed can take the place of the commanded one.

    Attributes:
        most_missing: Share of the samples that may be missing; they are interpolated [-].
        standing: While the command is to stand, readings up to so many standard deviations of their
            noise are a standing wheel [-]: of 10,000 readings none is farther out by chance.
    """

    most_missing: float = 0.1
    standing: float = 4.0


DEFAULT_WHEEL_SPEED = WheelSpeedSettings()


@dataclass(frozen=True, eq=False)
class WheelSpeed:
    """Measured and commanded speed of a wheel at the same times.

    Attributes:
        time: From the first command on [s], shape (samples,).
        measured, commanded: Angular velocity [rad/s], shape (samples,).
        noise: Standard deviation of the white noise of the measured one [rad/s].
    """

    time: np.ndarray
    measured: np.ndarray
    commanded: np.ndarray
    noise: float


def measured_wheel_speed(
    run: RunLog, settings: WheelSpeedSettings = DEFAULT_WHEEL_SPEED
) -> WheelSpeed | None:
    """Speed that a run's wheel was measured to turn at, while it was commanded.

    Args:
        run: Recorded run.
        settings: How much of it may be missing.

    Returns:
        The speed; None where it was not measured, is too incomplete, or is the command itself,
        which a rig without an encoder may log.
    """
    omega, command = run.measured.omega, run.command
    if omega is None:
        return None
    time = run.measured.time - command.time[0]
    during = (time >= 0) & (time <= command.time[-1] - command.time[0])
    there = during & np.isfinite(omega)
    if there.sum() < max(2, (1 - settings.most_missing) * during.sum()):
        return None
    measured = np.interp(time[during], time[there], omega[there])
    commanded = np.interp(time[during], command.time - command.time[0], command.omega)
    if np.array_equal(measured, commanded):
        return None
    noise = white_noise(measured)
    stands = (commanded == 0) & (np.abs(measured) <= settings.standing * noise)
    return WheelSpeed(time[during], np.where(stands, 0.0, measured), commanded, noise)


def driven_by(trial: Trial, speed: WheelSpeed) -> Trial:
    """The trial with its wheel turned by a measured speed in place of the commanded one.

    Before the first reading and after the last one the command holds.

    Args:
        trial: Command of a run.
        speed: Measured speed of its wheel.
    """
    knots = np.asarray(trial.time)
    outside = knots[(knots < speed.time[0]) | (knots > speed.time[-1])]
    time = np.union1d(speed.time, outside)
    omega = np.where(
        np.isin(time, outside),
        np.interp(time, knots, np.asarray(trial.omega)),
        np.interp(time, speed.time, speed.measured),
    )
    vx = np.interp(time, knots, np.asarray(trial.vx))
    return replace(trial, time=as_real(time), omega=as_real(omega), vx=as_real(vx))
