"""Motion of a recorded wheel at the times of a film's frames, and the sand's force on its plates.

The forces are those of the reference model, by the set-up in the run log, at the recorded place
and speed: they are not measured. A wheel at rest carries its load by friction in any direction,
so there they say little.
"""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from drftjax.common.errors import InputError
from drftjax.runlog.record import Reals, RecordedSetup, RunLog
from drftjax.setups.from_run import setup_from_run


@dataclass(frozen=True)
class FilmSettings:
    """Numbers of a film.

    Attributes:
        frame_time: Time that a frame is shown [s]; a GIF counts in hundredths of a second. The
            paper's wheel turns by 2.4 degrees in it.
        max_frames: Frames at most: two minutes of film, which take some minutes to draw.
        slope_time: Time over which a speed is taken from readings [s]: 20 um of noise then make
            0.1 mm/s, a thousandth of the rim's speed.
        dots_per_inch: Of a frame, 560 pixels wide.
    """

    frame_time: float = 0.08
    max_frames: int = 1500
    slope_time: float = 0.2
    dots_per_inch: int = 80


DEFAULT_FILM = FilmSettings()


@dataclass(frozen=True, eq=False)
class WheelMotion:
    """Motion of the wheel; all of shape (frames,).

    Attributes:
        time: From the run's start [s].
        x, z: Place of the axle, z = 0 where the rim just touches the sand [m].
        vx, vz: Its velocity [m/s].
        angle: Angle turned, positive driving forward [rad].
        omega: Angular velocity [rad/s].
        zeta: Scaling factor of the sand's strength [-]; None where the log has none.
    """

    time: Reals
    x: Reals
    z: Reals
    vx: Reals
    vz: Reals
    angle: Reals
    omega: Reals
    zeta: Reals | None


@dataclass(frozen=True, eq=False)
class PlateForces:
    """Plates of the wheel and the sand's force on each.

    Attributes:
        ends: Both ends (x, z) of each plate from the axle [m], shape (frames, plates, 2, 2).
        force: Force (x, z) [N], shape (frames, plates, 2).
    """

    ends: Reals
    force: Reals


def wheel_motion(run: RunLog, speed: float, settings: FilmSettings = DEFAULT_FILM) -> WheelMotion:
    """Motion of a run's wheel at the times of the frames.

    x is measured, or else the integral of the carriage's commanded speed; the angle is the
    integral of the wheel's speed, measured or else commanded.

    Args:
        run: The run.
        speed: Of the film, in times of real time [-].
        settings: Numbers of the film.

    Raises:
        InputError: where the run does not tell the motion, or the film would be too long.
    """
    measured, command = run.measured, run.command
    if measured.z is None:
        raise InputError("z was not measured, which shows the wheel sink")
    begin, end = measured.time[0], measured.time[-1]
    if measured.time.size < 2:
        raise InputError("the run has one reading; a film needs two or more")
    frames = math.floor((end - begin) / (speed * settings.frame_time)) + 1
    if frames > settings.max_frames:
        least = (end - begin) / (settings.frame_time * (settings.max_frames - 1))
        raise InputError(
            f"{frames} frames would show its {end - begin:g} s, must be at most "
            f"{settings.max_frames}: give --speed {_rounded_up(least):g} or more"
        )
    time = begin + speed * settings.frame_time * np.arange(frames)
    if measured.x is not None:
        travel = measured.time, measured.x
    elif command.vx is not None:
        travel = command.time, _integral(command.time, command.vx)
    else:
        raise InputError("x was not measured, and no speed of the carriage was commanded")
    turning = (command.time, command.omega)
    if measured.omega is not None:
        turning = measured.time, measured.omega
    height = measured.time, measured.z
    zeta = run.setup.scaling_factor_initial
    if run.online is not None:
        zetas = np.interp(time, run.online.time, run.online.zeta)
    else:
        zetas = None if zeta is None else np.full(frames, zeta)
    return WheelMotion(
        time=time,
        x=np.interp(time, *travel),
        z=np.interp(time, *height),
        vx=_slope(time, *travel, settings.slope_time),
        vz=_slope(time, *height, settings.slope_time),
        angle=np.interp(time, turning[0], _integral(*turning)),
        omega=np.interp(time, *turning),
        zeta=zetas,
    )


def _rounded_up(value: float) -> float:
    """A number rounded up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit


def _integral(time: Reals, values: Reals) -> Reals:
    """Integral of values that are linear in between, from the first time on."""
    pieces = np.diff(time) * (values[1:] + values[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(pieces)])


def _slope(at: Reals, time: Reals, values: Reals, span: float) -> Reals:
    """Slope of values around each time; nearer to an end, on the side that is left."""
    before = np.maximum(at - span / 2, time[0])
    after = np.minimum(at + span / 2, time[-1])
    rise = np.interp(after, time, values) - np.interp(before, time, values)
    return rise / np.maximum(after - before, 1e-9)


def wheel_outline(setup: RecordedSetup) -> Reals:
    """Corners (x, z) of the wheel's outline from its axle, at an angle of zero [m].

    Raises:
        InputError: where the wheel's radius is not known.
    """
    (radius,) = setup.require("wheel_radius")
    count = setup.grouser_count or 0
    height, thickness = setup.grouser_height or 0.0, setup.grouser_thickness or 0.0
    if not count:
        around = np.linspace(-math.pi, math.pi, 181)
        return radius * np.stack([np.sin(around), -np.cos(around)], axis=1)
    half, pitch = thickness / 2 / radius, 2 * math.pi / count
    # One grouser that points straight down, and the rim up to the next.
    rim = np.linspace(half, pitch - half, 12)
    tip = radius + height
    sector = np.concatenate(
        [
            [[-thickness / 2, -tip], [thickness / 2, -tip]],
            radius * np.stack([np.sin(rim), -np.cos(rim)], axis=1),
        ]
    )
    return np.concatenate([turned(sector, -pitch * place) for place in range(count)])


def turned(points: Reals, angle: float) -> Reals:
    """Points (x, z) turned forward by an angle [rad] about the axle."""
    sine, cosine = math.sin(angle), math.cos(angle)
    x, z = points[..., 0], points[..., 1]
    return np.stack([x * cosine + z * sine, z * cosine - x * sine], axis=-1)


def plate_forces(run: RunLog, motion: WheelMotion) -> PlateForces:
    """Force on each plate by the reference model, at the recorded motion.

    Raises:
        InputError: names what the run's set-up lacks.
    """
    if motion.zeta is None:
        raise InputError("the run has no zeta")
    setup = setup_from_run(run)
    simulator = setup.trial().simulator.prepared()

    @jax.jit
    @jax.vmap
    def load(x, z, vx, vz, angle, omega, zeta):
        place, velocity = jnp.stack([x, z]), jnp.stack([vx, vz])
        found = simulator.plate_load(place, velocity, angle, omega, zeta)
        return found.plates, jnp.stack(found.wrenches()[:2], axis=-1)

    m = motion
    plates, force = jax.tree.map(np.asarray, load(m.x, m.z, m.vx, m.vz, m.angle, m.omega, m.zeta))
    half = plates.area / setup.wheel.width / 2
    centre = np.stack([plates.x, plates.z], axis=-1)
    along = np.stack([plates.normal_z, -plates.normal_x], axis=-1) * half[..., None]
    real = plates.area[0] > 0  # others only fill the processor's vectors
    return PlateForces(np.stack([centre - along, centre + along], axis=-2)[:, real], force[:, real])
