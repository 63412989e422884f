"""How a run moved, from what was commanded and what was recorded of it, smoothed."""

from dataclasses import dataclass

import numpy as np

from diagnose.dataset import RigDataset, pitch
from diagnose.linear.residual_blocks import SlowFastSplit
from drftjax.physics.command import with_zero_crossings
from drftjax.physics.rig import DrivenCarriage

# Under this share of its fastest rim speed a wheel counts as standing.
STANDING = 0.02


# A speed that changes by less than this share of the fastest in a second is steady.
STEADY = 0.02


PHASES = ("stand", "accelerate", "steady", "decelerate", "rest")


@dataclass(frozen=True, eq=False)
class RunKinematics:
    """One run's motion at the samples compared.

    Attributes:
        time: Of the samples, from the run's start [s].
        omega: Commanded angular velocity [rad/s].
        angle: Wheel angle as commanded [rad].
        turning: Turning so far, either way [rad].
        travel: Way from the start [m]; None where nothing tells it.
        vx: Carriage speed [m/s]; None likewise.
        sinkage: Depth of the axle below free rolling [m]; None likewise.
        vz: Speed of rising [m/s]; None likewise.
        radius: Rim radius [m].
        grousers: Grousers in a turn; 0 without any.
        phase: Number of each sample's phase of the command, in the order of `PHASES`.
        bins: Number of each sample's half second.
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

    @property
    def slip_speed(self) -> np.ndarray | None:
        """How fast the rim runs ahead of the ground [m/s]."""
        return None if self.vx is None else self.radius * self.omega - self.vx

    @property
    def slip(self) -> np.ndarray | None:
        """Slip ratio [-]; NaN where the wheel stands."""
        if self.slip_speed is None:
            return None
        rim = self.radius * self.omega
        turning = np.abs(rim) > STANDING * max(float(np.abs(rim).max(initial=0)), 1e-9)
        return np.where(turning, self.slip_speed / np.where(turning, rim, 1), np.nan)


def kinematics_of_run(
    case: RigDataset, run: int, splitter: SlowFastSplit | None = None
) -> RunKinematics:
    """How a run moved.

    Args:
        case: Its case.
        run: Its number.
        splitter: Of its samples; made where none is given.
    """
    trial, time = case.runs[run].trial, case.time(run)
    splitter = SlowFastSplit.of(time) if splitter is None else splitter
    knots, omegas = np.asarray(trial.time), np.asarray(trial.omega)
    driven = isinstance(trial.simulator.rig.carriage, DrivenCarriage)
    recorded = dict(zip(case.channels, case.recorded(run), strict=True))

    def smooth(channel: str) -> tuple[np.ndarray | None, np.ndarray | None]:
        values = recorded.get(channel)
        if values is None or not np.isfinite(values).all():
            return None, None
        means, centres = splitter.mean @ values, splitter.mean @ time
        rate = np.gradient(means, centres) if len(means) > 1 else np.zeros(1)
        return splitter.back @ means, splitter.back @ rate

    z, vz = smooth("z")
    if driven:
        vx = np.interp(time, knots, np.asarray(trial.vx))
        travel = _integral(time, knots, np.asarray(trial.vx))
    else:
        x, vx = smooth("x")
        travel = None if x is None else x - x[0]
    radius = float(trial.simulator.wheel.radius)
    between, either_way, vxs = with_zero_crossings(knots, omegas, np.asarray(trial.vx))
    either_way = np.abs(either_way)
    speed = radius * either_way + (np.abs(vxs) if driven else 0)
    gap = pitch(case.trials[run])
    return RunKinematics(
        time,
        np.interp(time, knots, omegas),
        float(trial.start.angle) + _integral(time, knots, omegas),
        _integral(time, between, either_way),
        travel,
        vx,
        None if z is None else -z,
        vz,
        radius,
        round(2 * np.pi / gap) if np.isfinite(gap) else 0,
        _phases(time, between, speed),
        np.argmax(splitter.mean > 0, axis=0),
    )


def _integral(time: np.ndarray, knots: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Integral from zero to `time` of a rate given at knots, straight between them."""
    grid = np.union1d(knots, time)
    along = np.interp(grid, knots, rate)
    total = np.r_[0, np.cumsum(np.diff(grid) * (along[1:] + along[:-1]) / 2)]
    return np.interp(time, grid, total)


def _phases(time: np.ndarray, knots: np.ndarray, speed: np.ndarray) -> np.ndarray:
    fastest = max(float(speed.max(initial=0)), 1e-12)
    now = np.interp(time, knots, speed)
    # Over a quarter of a second, so that rounding in a recorded command is no acceleration.
    ahead, behind = (np.interp(time + shift, knots, speed) for shift in (0.125, -0.125))
    growth = (ahead - behind) / 0.25
    phase = np.full(len(time), PHASES.index("steady"))
    phase[growth > STEADY * fastest] = PHASES.index("accelerate")
    phase[growth < -STEADY * fastest] = PHASES.index("decelerate")
    standing = now < STANDING * fastest
    first = np.argmax(~standing) if (~standing).any() else len(time)
    later = np.arange(len(time)) >= first
    phase[standing & ~later] = PHASES.index("stand")
    phase[standing & later] = PHASES.index("rest")
    return phase
