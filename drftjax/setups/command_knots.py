"""Corners of a command: the knots at which it bends, beside all that was measured or rounded."""

from dataclasses import dataclass

import numpy as np

from drftjax.setups.setup import CommandSetUp


@dataclass(frozen=True)
class KnotSettings:
    """Distances from a straight line up to which a knot lies on it.

    Attributes:
        scatter: Error of a measured or rounded speed, as a share of the largest of its run [-].
        rounding: Rounding of a profile written in decimals, as a share of the largest speed [-];
            absolute below 1 in the unit of the channel.
    """

    scatter: float = 0.02
    rounding: float = 1e-9


DEFAULT_KNOTS = KnotSettings()


def simplify_command(command: CommandSetUp, settings: KnotSettings = DEFAULT_KNOTS) -> CommandSetUp:
    """The command as few straight lines, none farther from its knots than the scatter.

    Knots that are left out lie on the lines; those that are kept are as they were. Each stretch is
    split where it is farthest from straight (Ramer 1972, Douglas & Peucker 1973), then knots that
    a line passes as well are taken out again.

    Args:
        command: Profile of a run.
        settings: Distance from a line that is scatter.
    """
    command = decimate_command(command, settings)
    channels = [np.asarray(c, float) for c in (command.omega, command.vx) if c is not None]
    largest = [max(float(np.abs(c).max()), np.finfo(float).tiny) for c in channels]
    time = np.asarray(command.time, float)
    values = np.stack([c / most for c, most in zip(channels, largest, strict=True)])
    kept = _drop_knots(time, values, _split(time, values, settings.scatter), settings.scatter)

    def at(column: list[float]) -> list[float]:
        return [column[knot] for knot in kept]

    vx = None if command.vx is None else at(command.vx)
    return CommandSetUp(at(command.time), at(command.omega), vx, command.omega_unit)


def _distance(time: np.ndarray, values: np.ndarray, first: int, last: int) -> np.ndarray:
    """Distance of the knots between two from the line that joins these, largest over the channels.

    Args:
        time: Knots [s], shape (knots,).
        values: Channels as shares of their largest value [-], shape (channels, knots).
        first, last: The two knots.

    Returns:
        Distances [-], shape (last - first - 1,).
    """
    between = slice(first + 1, last)
    share = (time[between] - time[first]) / (time[last] - time[first])
    line = values[:, first, None] + share * (values[:, last] - values[:, first])[:, None]
    return np.abs(values[:, between] - line).max(axis=0)


def _split(time: np.ndarray, values: np.ndarray, scatter: float) -> list[int]:
    """Knots that lines must pass: each stretch is split where it is farthest from straight."""
    kept, left = {0, len(time) - 1}, [(0, len(time) - 1)]
    while left:
        first, last = left.pop()
        distance = _distance(time, values, first, last)
        if distance.max(initial=0.0) > scatter:
            middle = first + 1 + int(distance.argmax())
            kept.add(middle)
            left += [(first, middle), (middle, last)]
    return sorted(kept)


def _drop_knots(time: np.ndarray, values: np.ndarray, kept: list[int], scatter: float) -> list[int]:
    """The knots without those that the line between their neighbours passes as well.

    A split falls anywhere on a level stretch, where scatter is largest.
    """

    def distance(place: int) -> float:
        return float(_distance(time, values, kept[place - 1], kept[place + 1]).max())

    kept = list(kept)
    least = [distance(place) for place in range(1, len(kept) - 1)]
    while least and min(least) <= scatter:
        place = 1 + int(np.argmin(least))
        del kept[place], least[place - 1]
        for beside in (place - 1, place):
            if 0 < beside < len(kept) - 1:
                least[beside - 1] = distance(beside)
    return kept


def decimate_command(command: CommandSetUp, settings: KnotSettings = DEFAULT_KNOTS) -> CommandSetUp:
    """The same profile without the knots that lie on a straight line between their neighbours.

    Args:
        command: Profile of a run.
        settings: Distance from a line that is rounding.
    """
    time = np.asarray(command.time)
    channels = [np.asarray(c) for c in (command.omega, command.vx) if c is not None]
    kept = [0]
    for knot in range(1, len(time) - 1):
        if any(_bends(time, v, kept[-1], knot, settings.rounding) for v in channels):
            kept.append(knot)
    kept.append(len(time) - 1)

    def at(values: list[float]) -> list[float]:
        return [values[knot] for knot in kept]

    vx = None if command.vx is None else at(command.vx)
    return CommandSetUp(at(command.time), at(command.omega), vx, command.omega_unit)


def _bends(time: np.ndarray, values: np.ndarray, last: int, knot: int, rounding: float) -> bool:
    """True where the line from `last` to the knot after this one misses this one."""
    after = knot + 1
    slope = (values[after] - values[last]) / (time[after] - time[last])
    line = values[last] + slope * (time[knot] - time[last])
    return bool(abs(values[knot] - line) > rounding * max(1.0, float(np.abs(values).max())))


def extend_command(end: float, command: CommandSetUp) -> CommandSetUp:
    """The same profile with its last value held up to a later time.

    Args:
        end: Last knot of the new profile [s].
        command: Profile of a run.
    """
    vx = None if command.vx is None else [*command.vx, command.vx[-1]]
    time, omega = [*command.time, float(end)], [*command.omega, command.omega[-1]]
    return CommandSetUp(time, omega, vx, command.omega_unit)
