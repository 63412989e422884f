"""Kinematics of a recorded run, from its command and its smoothed readings."""

from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset, pitch
from diagnose.linear.residual_blocks import SlowFastSplit
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from drftjax.physics.command import with_zero_crossings
from drftjax.physics.rig import DrivenCarriage

PHASES = ("stand", "accelerate", "steady", "decelerate", "rest")
"""Phases of a command, in the order of `RunKinematics.phase`."""


@dataclass(frozen=True, eq=False)
class RunKinematics:
    """Motion of one run at the samples compared; every array has the shape (samples,).

    Attributes:
        time: Of the samples, from the run's start [s].
        omega: Commanded angular velocity [rad/s].
        angle: Wheel angle as commanded [rad].
        turning: Angle turned so far in either direction, never falling [rad].
        travel: Distance from the start, negative backward [m]; None where it is not known.
        vx: Carriage speed [m/s]; None likewise.
        sinkage: Depth of the axle below free rolling [m]; None likewise.
        vz: Speed of rising [m/s]; None likewise.
        radius: Rim radius [m].
        grousers: Grousers on the wheel; 0 without any.
        phase: Index of each sample's phase of the command in `PHASES`.
        bins: Index of each sample's half second.
        standing_speed: Share of the fastest rim speed below which the wheel stands [-].
    """

    time: np.ndarray
    omega: np.ndarray
    angle: np.ndarray
    turning: np.ndarray
    travel: np.ndarray | None
    vx: np.ndarray | None
    sinkage: np.ndarray | None
    vz: np.ndarray | None
    radius: float
    grousers: int
    phase: np.ndarray
    bins: np.ndarray
    standing_speed: float

    @property
    def slip_speed(self) -> np.ndarray | None:
        r"""Speed of the rim over the ground, $r\omega - v$ [m/s]."""
        return None if self.vx is None else self.radius * self.omega - self.vx

    @property
    def slip(self) -> np.ndarray | None:
        r"""Slip ratio $(r\omega - v) / (r\omega)$ [-]; NaN where the wheel stands."""
        if self.slip_speed is None:
            return None
        rim = self.radius * self.omega
        fastest = max(float(np.abs(rim).max(initial=0)), 1e-9)
        turns = np.abs(rim) > self.standing_speed * fastest
        return np.where(turns, self.slip_speed / np.where(turns, rim, 1), np.nan)


def kinematics_of_run(
    dataset: RigDataset,
    run: int,
    splitter: SlowFastSplit | None = None,
    settings: LocalizationSettings = DEFAULT_LOCALIZATION,
) -> RunKinematics:
    """Motion of a run at the samples compared.

    Positions are means over half seconds, linear in between; speeds are differences of these.

    Args:
        dataset: The runs.
        run: Index of the run.
        splitter: Of its samples; made where none is given.
        settings: Numbers of the phases.
    """
    trial, time = dataset.runs[run].trial, dataset.time(run)
    splitter = SlowFastSplit.of(time) if splitter is None else splitter
    knots, omegas = np.asarray(trial.time), np.asarray(trial.omega)
    driven = isinstance(trial.simulator.rig.carriage, DrivenCarriage)
    recorded = dict(zip(dataset.channels, dataset.recording(run), strict=True))

    def smooth(channel: str) -> tuple[np.ndarray | None, np.ndarray | None]:
        """A channel and its rate; None where it was not recorded."""
        values = recorded.get(channel)
        if values is None or not np.isfinite(values).all():
            return None, None
        means, centres = splitter.bin_means @ values, splitter.bin_means @ time
        rate = np.gradient(means, centres) if len(means) > 1 else np.zeros(1)
        return splitter.interpolation @ means, splitter.interpolation @ rate

    z, vz = smooth("z")
    if driven:
        vx = np.interp(time, knots, np.asarray(trial.vx))
        travel = _integral(time, knots, np.asarray(trial.vx))
    else:
        x, vx = smooth("x")
        travel = None if x is None else x - x[0]
    radius = float(trial.simulator.wheel.radius)
    fine_knots, fine_omegas, fine_vxs = with_zero_crossings(knots, omegas, np.asarray(trial.vx))
    speed = radius * np.abs(fine_omegas) + (np.abs(fine_vxs) if driven else 0)
    grouser_pitch = pitch(dataset.trials[run])
    return RunKinematics(
        time=time,
        omega=np.interp(time, knots, omegas),
        angle=float(trial.start.angle) + _integral(time, knots, omegas),
        turning=_integral(time, fine_knots, np.abs(fine_omegas)),
        travel=travel,
        vx=vx,
        sinkage=None if z is None else -z,
        vz=vz,
        radius=radius,
        grousers=round(2 * np.pi / grouser_pitch) if np.isfinite(grouser_pitch) else 0,
        phase=_phases(time, fine_knots, speed, settings),
        bins=np.argmax(splitter.bin_means > 0, axis=0),
        standing_speed=settings.standing_speed,
    )


def _integral(time: np.ndarray, knots: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Integral from zero to `time` of a rate given at knots, linear between them."""
    grid = np.union1d(knots, time)
    along = np.interp(grid, knots, rate)
    total = np.r_[0, np.cumsum(np.diff(grid) * (along[1:] + along[:-1]) / 2)]
    return np.interp(time, grid, total)


def _phases(
    time: np.ndarray, knots: np.ndarray, speed: np.ndarray, settings: LocalizationSettings
) -> np.ndarray:
    """Index in `PHASES` of each time, from the commanded speed at knots [m/s]."""
    fastest = max(float(speed.max(initial=0)), 1e-12)
    now = np.interp(time, knots, speed)
    half = settings.growth_window / 2
    ahead, behind = (np.interp(time + shift, knots, speed) for shift in (half, -half))
    growth = (ahead - behind) / settings.growth_window
    phase = np.full(len(time), PHASES.index("steady"))
    phase[growth > settings.steady_growth * fastest] = PHASES.index("accelerate")
    phase[growth < -settings.steady_growth * fastest] = PHASES.index("decelerate")
    standing = now < settings.standing_speed * fastest
    first = np.argmax(~standing) if (~standing).any() else len(time)
    later = np.arange(len(time)) >= first
    phase[standing & ~later] = PHASES.index("stand")
    phase[standing & later] = PHASES.index("rest")
    return phase
