"""Observation of a recorded run: channels, noise and samples that a simulation is compared with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from drftjax.common.errors import InputError
from drftjax.recorded.commanded_motion import DEFAULT_MOTION, MotionSettings, commanded_speed
from drftjax.runlog.record import CHANNELS, RunLog

FREE_CHANNELS = ("x", "z", "torque")


FREE_CHANNELS_WITH_FORCES = ("x", "z", "fx", "fz", "torque")


DRIVEN_CHANNELS = ("z", "fx", "fz", "torque")


# A median absolute second difference of white noise is this many standard deviations.
SECOND_DIFFERENCE_SCALE = 0.6745 * np.sqrt(6.0)


def _smallest_noise() -> Mapping[str, float]:
    return MappingProxyType({"x": 1e-6, "z": 1e-6, "fx": 1e-2, "fz": 1e-2, "torque": 1e-3})


@dataclass(frozen=True)
class ObservationSettings:
    """Numbers that decide which samples are compared, and their smallest noise.

    Attributes:
        min_noise: Smallest standard deviation of an instrument's noise by channel [m, N, N m]: no
            rig's instruments resolve less.
        clock_rounding: Difference of two clocks that write the same instant [s].
        motion: Speeds that count as standing.
    """

    min_noise: Mapping[str, float] = field(default_factory=_smallest_noise)
    clock_rounding: float = 1e-9
    motion: MotionSettings = DEFAULT_MOTION


DEFAULT_OBSERVATION = ObservationSettings()


# Of the default settings, for code that is given none.
SMALLEST_NOISE = DEFAULT_OBSERVATION.min_noise


ROUNDING = DEFAULT_OBSERVATION.clock_rounding


@dataclass(frozen=True)
class Observation:
    """Recorded channels of one run that a simulation is compared with.

    Attributes:
        time: Recorded times from the first command on [s], shape (samples,).
        channels: Names among x, z, fx, fz, torque.
        values: Recorded values [m, N, N m], shape (channels, samples).
        noise: Standard deviation of the instrument's white noise, shape (channels,).
        counts: True for samples that are compared, shape (samples,).
        unused: Channels that were recorded and are not compared.
        step_error: Error of simulated channels by their step, which is taken off before they are
            compared, by `drftjax.simulation.step_error`; like `values`, or None for none.
    """

    time: np.ndarray
    channels: tuple[str, ...]
    values: np.ndarray
    noise: np.ndarray
    counts: np.ndarray
    unused: tuple[str, ...] = ()
    step_error: np.ndarray | None = None

    @property
    def after_start(self) -> np.ndarray:
        """True for samples that were not taken before the command begins, shape (samples,)."""
        return self.time >= -ROUNDING

    @property
    def intervals(self) -> np.ndarray:
        """Whole usual intervals from the sample before [-], infinite first, shape (samples,)."""
        return sampling_intervals(self.time)

    def select_channels(self, compare: Sequence[str]) -> "Observation":
        """The same with only these of its channels compared.

        Args:
            compare: Names of channels.

        Raises:
            InputError: the observation has none of them.
        """
        kept = [number for number, name in enumerate(self.channels) if name in compare]
        if len(kept) == len(self.channels):
            return self
        if not kept:
            raise InputError(f"nothing to compare; it has {', '.join(self.channels)} alone")
        others = tuple(name for name in self.channels if name not in compare)
        return replace(self._at(kept), unused=(*self.unused, *others))

    def in_order(self, channels: Sequence[str]) -> "Observation":
        """The same with these of its channels, in this order.

        Args:
            channels: Names of channels that it has.
        """
        return self._at([self.channels.index(name) for name in channels])

    def thinned(self, kept: slice) -> "Observation":
        """The same with these of its samples alone, and with the noise that they show."""
        values = self.values[:, kept]
        noise = [
            max(white_noise(row), SMALLEST_NOISE[name])
            for name, row in zip(self.channels, values, strict=True)
        ]
        return replace(
            self,
            time=self.time[kept],
            values=values,
            counts=self.counts[kept],
            noise=np.array(noise),
            step_error=None if self.step_error is None else self.step_error[:, kept],
        )

    def _at(self, numbers: Sequence[int]) -> "Observation":
        picked = list(numbers)
        return replace(
            self,
            channels=tuple(self.channels[number] for number in picked),
            values=self.values[picked],
            noise=self.noise[picked],
            step_error=None if self.step_error is None else self.step_error[picked],
        )

    def sinkage(self) -> np.ndarray:
        """Recorded sinkage H = -z [m], shape (samples,).

        Raises:
            InputError: the run has none.
        """
        if "z" not in self.channels:
            raise InputError("has no /measured/z, so its sinkage is not known")
        return -self.values[self.channels.index("z")]

    def by_channel(self) -> dict[str, tuple[np.ndarray, float]]:
        """Values [m, N, N m], shape (samples,), and noise in their unit, by channel."""
        return {
            name: (values, float(noise))
            for name, values, noise in zip(self.channels, self.values, self.noise, strict=True)
        }

    @property
    def mean_speed(self) -> float:
        """Travel from the first sample to the last over their time [m/s]; 0 without either."""
        if "x" not in self.channels or len(self.time) < 2:
            return 0.0
        x, _ = self.by_channel()["x"]
        return float((x[-1] - x[0]) / (self.time[-1] - self.time[0]))


def sampling_intervals(time: np.ndarray) -> np.ndarray:
    """Whole usual intervals from the sample before [-].

    Args:
        time: Times of the samples [s], shape (samples,).

    Returns:
        Intervals, more than one after a gap and infinite for the first sample, shape (samples,).
    """
    steps = np.diff(time)
    usual = np.median(steps) if len(steps) else 1.0
    return np.r_[np.inf, np.maximum(np.round(steps / usual), 1.0)]


def comparable_channels(driven: bool, carriage_forces: bool = False) -> tuple[str, ...]:
    """Names of the channels that are compared where they are recorded.

    Args:
        driven: True where the carriage is driven, so that its x is given; False where it is free.
        carriage_forces: True where the forces of a free carriage are compared, too.
    """
    free = FREE_CHANNELS_WITH_FORCES if carriage_forces else FREE_CHANNELS
    return DRIVEN_CHANNELS if driven else free


def require_channels(names: Sequence[str]) -> None:
    """Refuse an empty list of channels to compare, or names that are no channels.

    Raises:
        InputError: names them, and the channels that there are.
    """
    strange = [each for each in names if each not in CHANNELS]
    if strange or not names:
        given = ", ".join(strange) or "empty"
        raise InputError(
            f"the channels to compare are {given}, must be among {', '.join(CHANNELS)}"
        )


def observe(
    run: RunLog,
    radius: float,
    *,
    keep_rest: bool = False,
    compare: Sequence[str] = CHANNELS,
    carriage_forces: bool = False,
    settings: ObservationSettings = DEFAULT_OBSERVATION,
) -> Observation:
    """Channels of a recorded run that its simulation predicts.

    With a free carriage these are x, z and torque, with a driven one z, the forces and torque: x is
    then given.

    Args:
        run: Recorded run.
        radius: Rim radius [m]; decides when the wheel stands beside a carriage that moves.
        keep_rest: True to compare the samples after the wheel has stopped for good, too. A
            standing wheel holds whatever sinkage it has reached, so they say nothing of the
            sand's parameters, and what a rig does at rest is not the model's matter.
        compare: Channels that are compared, of those that the simulation predicts.
        carriage_forces: True to compare the forces on a free carriage, too. They say nothing of the
            sand that its motion does not say, but how the carriage is held, where x and z are
            compared as well. Those of a run in the loop are not.
        settings: Smallest noise of each channel, and speeds that count as standing.

    Raises:
        InputError: the run has none of the channels, never moves, or was not recorded meanwhile.
    """
    require_channels(compare)
    # The loop drives the carriage of a run that was made in it.
    with_forces = carriage_forces and run.online is None
    predicted = comparable_channels(run.command.vx is not None, with_forces)
    wanted = tuple(each for each in predicted if each in compare)
    recorded = tuple(each for each in CHANNELS if getattr(run.measured, each) is not None)
    channels = tuple(each for each in wanted if each in recorded)
    vx = run.command.vx
    if vx is None and not {"x", "z"} <= {*channels}:
        # A force tells what holds a free carriage only beside its motion.
        channels = tuple(each for each in channels if each not in ("fx", "fz"))
    # Torque alone does not say how deep a free wheel is.
    needed = tuple(each for each in wanted if vx is not None or each in ("x", "z"))
    if not needed:
        enough = "x or z" if vx is None else " or ".join(predicted)
        carriage = "free" if vx is None else "driven"
        raise InputError(
            f"of a {carriage} carriage {enough} must be compared, not {', '.join(compare)} alone"
        )
    if not set(needed) & set(channels):
        raise InputError(f"nothing to compare; /measured has none of {', '.join(needed)}")
    if not np.any(run.command.omega) and (vx is None or not np.any(vx)):
        raise InputError("the commanded profile never moves the wheel")
    values = np.stack([getattr(run.measured, each) for each in channels])
    noise = [instrument_noise(c, v, settings) for v, c in zip(values, channels, strict=True)]
    time = run.measured.time - run.command.time[0]
    # Before the command begins and past its end nothing is simulated.
    end = float(run.command.time[-1] - run.command.time[0])
    last = end if keep_rest else min(end, _last_motion(run, radius, settings.motion))
    rounding = settings.clock_rounding
    counts = (time >= -rounding) & (time <= last + rounding)
    if not counts.any():
        raise InputError("nothing to compare; no sample lies within the commanded profile")
    unused = tuple(each for each in recorded if each not in channels)
    return Observation(time, channels, values, np.array(noise), counts, unused)


def _last_motion(run: RunLog, radius: float, settings: MotionSettings) -> float:
    """Time from the first command after which neither wheel nor carriage is to move [s]."""
    command = run.command
    speed = commanded_speed(radius, command.omega, command.vx)
    moving = speed > settings.standing_share * speed.max()
    if moving[-1]:
        return np.inf
    last = int(np.flatnonzero(moving)[-1])
    return float(command.time[last + 1] - command.time[0])


def white_noise(values: np.ndarray) -> float:
    r"""Standard deviation of white noise on a slow signal, from its second differences.

    $\hat\sigma = \mathrm{median}|y_{i+1} - 2 y_i + y_{i-1}| / (0.6745 \sqrt 6)$.

    Args:
        values: Samples at even intervals, shape (samples,).

    Returns:
        Standard deviation in the unit of the samples; 0 of fewer than three.
    """
    if len(values) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(values, 2))) / SECOND_DIFFERENCE_SCALE)


def instrument_noise(
    channel: str, values: np.ndarray, settings: ObservationSettings = DEFAULT_OBSERVATION
) -> float:
    """Standard deviation of an instrument's noise, not below the smallest of its channel.

    Args:
        channel: Name among x, z, fx, fz, torque.
        values: Its samples [m, N, N m], shape (samples,).
        settings: Smallest noise of each channel.
    """
    return max(white_noise(values), settings.min_noise[channel])


# Unit in reports and factor from SI: lengths in mm.
SHOWN = {
    "x": ("mm", 1e3),
    "z": ("mm", 1e3),
    "fx": ("N", 1.0),
    "fz": ("N", 1.0),
    "torque": ("N m", 1.0),
}
