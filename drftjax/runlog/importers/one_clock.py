"""Channels on their own time axes, brought to the one time axis that a run log has."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from drftjax.runlog.importers.table import Reals


@dataclass(frozen=True)
class ClockSettings:
    """Numbers that decide which samples of several channels belong together.

    Attributes:
        max_gap: Longest interval over which a channel is interpolated, in its usual intervals [-].
            One lost sample doubles an interval; a longer pause is a gap, of which nothing is known.
    """

    max_gap: float = 2.5


DEFAULT_CLOCK = ClockSettings()


@dataclass(frozen=True)
class TimedChannel:
    """One channel with its own times.

    Attributes:
        time: Increasing times [s], shape (samples,).
        values: Values, shape (samples,).
    """

    time: Reals
    values: Reals


def on_one_clock(
    channels: Mapping[str, TimedChannel],
    clock: str | None = None,
    settings: ClockSettings = DEFAULT_CLOCK,
) -> tuple[Reals, dict[str, Reals], list[str]]:
    """Channels at the times of one of them.

    The times are those of the channel with the fewest samples, so that no slow sensor's value is
    made up. The others are taken at these times where they have a sample, else interpolated
    linearly between two neighbours that are near. A time at which a channel has a gap is left out.

    Args:
        channels: Channels by name, one at least.
        clock: Name of the channel whose times are kept; the one with the fewest where it is None.
        settings: Longest gap that is bridged.

    Returns:
        Times [s], values by name at these times, and a sentence for each loss.

    Raises:
        InputError: the clock is no channel, or the channels have no time in common.
    """
    if clock is not None and clock not in channels:
        raise InputError(f"clock is {clock!r}, it must be one of {', '.join(channels)}")
    kept = clock or min(channels, key=lambda name: len(channels[name].time))
    time = channels[kept].time
    found = {name: _at(time, each, settings) for name, each in channels.items()}
    known = np.all([valid for _, valid in found.values()], axis=0)
    if not known.any():
        names = ", ".join(channels)
        raise InputError(f"{names} have no time in common; a run needs all of them at once")
    values = {name: each[known] for name, (each, _) in found.items()}
    return time[known], values, _losses(kept, channels, int(known.sum()))


def pauses(
    channels: Mapping[str, TimedChannel], settings: ClockSettings = DEFAULT_CLOCK
) -> list[str]:
    """Sentence on the longest pause of each channel that pauses for longer than is bridged.

    Args:
        channels: Channels by name.
        settings: Longest gap that is bridged.
    """
    told = []
    for name, each in channels.items():
        steps = np.diff(each.time)
        if steps.size and steps.max() > settings.max_gap * np.median(steps):
            at = int(steps.argmax())
            told.append(
                f"{name} has no value for {steps[at]:.3g} s after {each.time[at]:.4g} s; it is "
                "taken to change evenly there"
            )
    return told


def _at(
    time: Reals, channel: TimedChannel, settings: ClockSettings
) -> tuple[Reals, NDArray[np.bool_]]:
    """Values of a channel at given times, and the times at which they are known."""
    own = channel.time
    after = np.clip(np.searchsorted(own, time), 0, len(own) - 1)
    before = np.maximum(after - 1, 0)
    hit = own[after] == time
    usual = np.median(np.diff(own)) if len(own) > 1 else 0.0
    inside = (own[0] <= time) & (time <= own[-1])
    near = own[after] - own[before] <= settings.max_gap * usual
    return np.interp(time, own, channel.values), hit | (inside & near)


def _losses(kept: str, channels: Mapping[str, TimedChannel], rows: int) -> list[str]:
    """Sentence on samples that the run does not keep; none where every channel is whole."""
    counts = {name: len(each.time) for name, each in channels.items()}
    if all(count == rows for count in counts.values()):
        return []
    others = ", ".join(f"{name} {count}" for name, count in counts.items() if name != kept)
    return [
        f"{kept} has {counts[kept]} values ({others}); the run keeps {rows} of its times, at which "
        "the other channels are known"
    ]
