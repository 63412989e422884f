"""What a recorded run offers to a fit: its channels at the recorded times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.recorded.commanded_motion import STANDS, commanded_speed
from drftjax.runlog.record import CHANNELS, Measured, RunLog

if TYPE_CHECKING:
    pass

FREE_CHANNELS = ("x", "z", "torque")


DRIVEN_CHANNELS = ("z", "fx", "fz", "torque")


# An instrument's noise cannot be told finer than this [m, N, N m].
SMALLEST_NOISE = {"x": 1e-6, "z": 1e-6, "fx": 1e-2, "fz": 1e-2, "torque": 1e-3}


# A median absolute second difference of white noise is this many standard deviations.
SECOND_DIFFERENCE_SCALE = 0.6745 * np.sqrt(6.0)


# Words of /online's flags: a tick had a reading of its own, and the loop refused it.
FRESH, REFUSED = "fresh", "refused"


# Word of /events for the same, with the value read; told within so long of the reading [s].
READING_REFUSED, NEAR = "reading_refused", 0.2


# Two clocks that write the same time may differ by this [s].
ROUNDING = 1e-9


@dataclass(frozen=True)
class Observation:
    """The channels of one run that a fit compares.

    Attributes:
        time: Recorded times from the run's start [s], shape (samples,).
        channels: Names among x, z, fx, fz, torque.
        values: What was recorded [m, N, N m], shape (channels, samples).
        noise: Standard deviation of the instrument's white noise, shape (channels,).
        counts: True for samples that are compared, shape (samples,).
        unused: Channels that were recorded and are not compared.
    """

    time: np.ndarray
    channels: tuple[str, ...]
    values: np.ndarray
    noise: np.ndarray
    counts: np.ndarray
    unused: tuple[str, ...] = ()

    @property
    def begun(self) -> np.ndarray:
        """True for samples that were not taken before the command begins, shape (samples,)."""
        return self.time >= -ROUNDING

    @property
    def intervals(self) -> np.ndarray:
        """Whole usual intervals from the sample before [-], infinite first, shape (samples,)."""
        return intervals_of(self.time)

    def of(self, compare: Sequence[str]) -> "Observation":
        """The same with no other channels compared than these, of those that are.

        Raises:
            InputError: where none is left.
        """
        kept = [number for number, name in enumerate(self.channels) if name in compare]
        if len(kept) == len(self.channels):
            return self
        if not kept:
            raise InputError(f"nothing to compare; it has {', '.join(self.channels)} alone")
        others = tuple(name for name in self.channels if name not in compare)
        return replace(
            self,
            channels=tuple(self.channels[number] for number in kept),
            values=self.values[kept],
            noise=self.noise[kept],
            unused=(*self.unused, *others),
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
        """Values and noise by the channel's name."""
        return {
            name: (values, float(noise))
            for name, values, noise in zip(self.channels, self.values, self.noise, strict=True)
        }


def intervals_of(time: np.ndarray) -> np.ndarray:
    """Whole usual intervals from the sample before [-], infinite first, of times [s] (samples,)."""
    steps = np.diff(time)
    usual = np.median(steps) if len(steps) else 1.0
    return np.r_[np.inf, np.maximum(np.round(steps / usual), 1.0)]


def refused_readings(run: RunLog) -> NDArray[np.bool_]:
    """Rows of /measured that the loop refused as jumps, or as no height a wheel can have.

    Each tick with a fresh reading has the next row. Where there are not as many of both, as in a
    run that was cut off, the log does not tell which rows they are.

    Args:
        run: Made in the loop or not.

    Returns:
        True for each such row, shape (samples,).
    """
    none = np.zeros(len(run.measured.time), bool)
    if run.online is None:
        return none | _told_by_events(run)
    bits = {word: bit for bit, word in run.online.meanings.items()}
    if not {FRESH, REFUSED} <= set(bits):
        return none
    fresh, refused = ((run.online.flags & bits[word]) != 0 for word in (FRESH, REFUSED))
    return refused[fresh] if fresh.sum() == len(none) else none


def _told_by_events(run: RunLog) -> NDArray[np.bool_]:
    """The same of a run whose carriage was free, which has no flags: by the readings told."""
    found = np.zeros(len(run.measured.time), bool)
    if run.events is None:
        return found
    codes = [code for code, word in run.events.meanings.items() if word == READING_REFUSED]
    told = np.isin(run.events.code, codes)
    channels = [each for each in (run.measured.z, run.measured.x) if each is not None]
    for time, value in zip(run.events.event_time[told], run.events.arg[told], strict=True):
        same = np.any([each == value for each in channels], axis=0)
        near = same & (np.abs(run.measured.time - time) <= NEAR)
        if near.any():
            away = np.where(near, np.abs(run.measured.time - time), np.inf)
            found[int(np.argmin(away))] = True
    return found


def drop_refused(run: RunLog) -> RunLog:
    """The run without the readings that the loop refused.

    Raises:
        InputError: where it refused them all.
    """
    kept = ~refused_readings(run)
    if kept.all():
        return run
    if not kept.any():
        raise InputError("the loop refused all its readings; at least one must be sound")
    measured = run.measured
    channels = {name: values[kept] for name, values in measured.channels().items()}
    return replace(run, measured=Measured(time=measured.time[kept], **channels))


def comparable(driven: bool) -> tuple[str, ...]:
    """Channels that are compared where they are recorded, with a driven or a free carriage."""
    return DRIVEN_CHANNELS if driven else FREE_CHANNELS


def require_channels(names: Sequence[str]) -> None:
    """Refuse channels to compare that there are not, or none.

    Raises:
        InputError: names them, and what there is.
    """
    strange = [each for each in names if each not in CHANNELS]
    if strange or not names:
        given = ", ".join(strange) or "empty"
        raise InputError(
            f"the channels to compare are {given}, must be among {', '.join(CHANNELS)}"
        )


def observe(
    run: RunLog, radius: float, *, keep_rest: bool = False, compare: Sequence[str] = CHANNELS
) -> Observation:
    """The channels of a run that its simulation predicts.

    With a free carriage these are x, z and torque, with a driven one z, the forces and torque: x is
    then given.

    Args:
        run: What was recorded.
        radius: Of the rim [m]; it says when the wheel stands beside a carriage that moves.
        keep_rest: Whether the samples after the wheel has stopped for good are compared too. A
            standing wheel holds whatever sinkage it has reached, so they say nothing of the
            sand's parameters, and what a rig does at rest is not the model's matter.
        compare: Channels that are compared, of those that the simulation predicts.

    Raises:
        InputError: where the run has none of them, never moves, or was not recorded meanwhile.
    """
    require_channels(compare)
    predicted = comparable(driven=run.command.vx is not None)
    wanted = tuple(each for each in predicted if each in compare)
    recorded = tuple(each for each in CHANNELS if getattr(run.measured, each) is not None)
    channels = tuple(each for each in wanted if each in recorded)
    vx = run.command.vx
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
    noise = [max(white_noise(v), SMALLEST_NOISE[c]) for v, c in zip(values, channels, strict=True)]
    time = run.measured.time - run.command.time[0]
    # Before the command begins and past its end nothing is simulated.
    end = float(run.command.time[-1] - run.command.time[0])
    last = end if keep_rest else min(end, _last_motion(run, radius))
    counts = (time >= -ROUNDING) & (time <= last + ROUNDING)
    if not counts.any():
        raise InputError("nothing to compare; no sample lies within the commanded profile")
    unused = tuple(each for each in recorded if each not in wanted)
    return Observation(time, channels, values, np.array(noise), counts, unused)


def _last_motion(run: RunLog, radius: float) -> float:
    """Time from the run's start after which neither wheel nor carriage is asked to move [s]."""
    command = run.command
    asked = commanded_speed(radius, command.omega, command.vx)
    moving = asked > STANDS * asked.max()
    if moving[-1]:
        return np.inf
    last = int(np.flatnonzero(moving)[-1])
    return float(command.time[last + 1] - command.time[0])


def white_noise(values: np.ndarray) -> float:
    """Standard deviation of white noise on a slow signal, from its second differences."""
    if len(values) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(values, 2))) / SECOND_DIFFERENCE_SCALE)


# Reports show lengths in mm.
SHOWN = {
    "x": ("mm", 1e3),
    "z": ("mm", 1e3),
    "fx": ("N", 1.0),
    "fz": ("N", 1.0),
    "torque": ("N m", 1.0),
}
