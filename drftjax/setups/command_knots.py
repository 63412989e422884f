"""The corners of a command: where it bends, for all that was measured or rounded in between."""

import numpy as np

from drftjax.setups.setup import CommandSetUp

# What a measured or rounded speed is off by, as a share of the largest of its run.
SCATTER = 0.02


def simplify_command(command: CommandSetUp) -> CommandSetUp:
    """The command as few straight lines, none further from its knots than `SCATTER`.

    Knots that are left out lie on the lines; those that are kept are as they were.
    """
    command = decimate_command(command)
    channels = [np.asarray(c, float) for c in (command.omega, command.vx) if c is not None]
    largest = [max(float(np.abs(c).max()), np.finfo(float).tiny) for c in channels]
    time = np.asarray(command.time, float)
    values = np.stack([c / most for c, most in zip(channels, largest, strict=True)])
    kept = _fewer(time, values, _split(time, values))

    def at(column: list[float]) -> list[float]:
        return [column[knot] for knot in kept]

    vx = None if command.vx is None else at(command.vx)
    return CommandSetUp(at(command.time), at(command.omega), vx, command.omega_unit)


def _off(time: np.ndarray, values: np.ndarray, first: int, last: int) -> np.ndarray:
    """How far the knots between two lie from the line that joins these."""
    between = slice(first + 1, last)
    share = (time[between] - time[first]) / (time[last] - time[first])
    line = values[:, first, None] + share * (values[:, last] - values[:, first])[:, None]
    return np.abs(values[:, between] - line).max(axis=0)


def _split(time: np.ndarray, values: np.ndarray) -> list[int]:
    """Knots that lines must pass: each stretch is split where it is furthest from straight."""
    kept, left = {0, len(time) - 1}, [(0, len(time) - 1)]
    while left:
        first, last = left.pop()
        off = _off(time, values, first, last)
        if off.max(initial=0.0) > SCATTER:
            middle = first + 1 + int(off.argmax())
            kept.add(middle)
            left += [(first, middle), (middle, last)]
    return sorted(kept)


def _fewer(time: np.ndarray, values: np.ndarray, kept: list[int]) -> list[int]:
    """The same without knots that the line between their neighbours passes as well.

    A split falls anywhere on a level stretch, where scatter is largest.
    """

    def off(place: int) -> float:
        return float(_off(time, values, kept[place - 1], kept[place + 1]).max())

    kept = list(kept)
    least = [off(place) for place in range(1, len(kept) - 1)]
    while least and min(least) <= SCATTER:
        place = 1 + int(np.argmin(least))
        del kept[place], least[place - 1]
        for beside in (place - 1, place):
            if 0 < beside < len(kept) - 1:
                least[beside - 1] = off(beside)
    return kept


def decimate_command(command: CommandSetUp) -> CommandSetUp:
    """The same profile without the knots that lie on a straight line between their neighbours."""
    time = np.asarray(command.time)
    channels = [np.asarray(c) for c in (command.omega, command.vx) if c is not None]
    kept = [0]
    for knot in range(1, len(time) - 1):
        if any(_bends(time, values, kept[-1], knot) for values in channels):
            kept.append(knot)
    kept.append(len(time) - 1)

    def at(values: list[float]) -> list[float]:
        return [values[knot] for knot in kept]

    vx = None if command.vx is None else at(command.vx)
    return CommandSetUp(at(command.time), at(command.omega), vx, command.omega_unit)


def _bends(time: np.ndarray, values: np.ndarray, last: int, knot: int) -> bool:
    """Whether the line from `last` to the knot after this one misses this one."""
    after = knot + 1
    slope = (values[after] - values[last]) / (time[after] - time[last])
    line = values[last] + slope * (time[knot] - time[last])
    # Rounding of a profile written in decimals, not a change anyone commanded.
    return bool(abs(values[knot] - line) > 1e-9 * max(1.0, float(np.abs(values).max())))


def held_until(end: float, command: CommandSetUp) -> CommandSetUp:
    """The same profile with its last value held to `end` [s]."""
    vx = None if command.vx is None else [*command.vx, command.vx[-1]]
    time, omega = [*command.time, float(end)], [*command.omega, command.omega[-1]]
    return CommandSetUp(time, omega, vx, command.omega_unit)
