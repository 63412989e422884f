"""Runs under the same condition, and the noise that their difference shows."""

from collections.abc import Sequence

import numpy as np

from drftjax.recorded.observation import ROUNDING, sampling_intervals
from drftjax.recorded.prepared_run import PreparedRun


def noise_after_interpolation(time: np.ndarray, wanted: np.ndarray) -> float:
    """Share of white noise's power that is left where a recording is read at other times."""
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    way = np.clip((wanted - time[after - 1]) / (time[after] - time[after - 1]), 0, 1)
    return float(np.mean(way**2 + (1 - way) ** 2))


def interpolate_recorded(time: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Whether a recording can be read at other times: not outside it, and not where it has gaps.

    Args:
        time: Of its samples [s], increasing.
        wanted: Other times [s], shape (times,).
    """
    inside = (wanted >= time[0] - ROUNDING) & (wanted <= time[-1] + ROUNDING)
    after = np.clip(np.searchsorted(time, wanted - ROUNDING), 0, len(time) - 1)
    at_sample = np.abs(time[after] - wanted) <= ROUNDING
    return inside & (at_sample | (sampling_intervals(time)[after] <= 1))


# Loads [kg, N] and commands [rad/s] are the same within this.
SAME = 1e-6


# Carriages whose speed was tuned to the sinkage repeat each other within this share of their top.
SAME_PACE = 0.02


# Runs whose sands are believed to differ by more than this in log zeta do not repeat each other.
SAME_SAND = 0.2


# A run that was stopped early is of the condition of another where it holds this share of it.
LEAST_SHARED = 0.5


def group_by_condition(candidates: Sequence[PreparedRun]) -> list[list[int]]:
    """Runs of the same command and load, by number; one that was stopped early is among them.

    Each run is held against the longest of a group, so that the order of the runs is no matter.
    """
    groups: list[list[int]] = []
    for number in sorted(range(len(candidates)), key=lambda each: _rank(candidates[each])):
        for group in groups:
            if _alike(candidates[group[0]], candidates[number]):
                group.append(number)
                break
        else:
            groups.append([number])
    return sorted(sorted(group) for group in groups)


def _rank(one: PreparedRun) -> tuple[float, ...]:
    """What orders runs, whatever they are called: the longest first."""
    command, rig, sand = one.setup.command, one.setup.rig, one.setup.terrain.zeta
    zeta = sand if isinstance(sand, float) else np.inf
    load = (rig.mass_x, rig.mass_z, rig.drawbar_load)
    return (-_lasts(one), zeta, *load, *(command.vx or ()), *command.omega)


def _lasts(one: PreparedRun) -> float:
    time = one.setup.command.time
    return time[-1] - time[0]


def _alike(one: PreparedRun, other: PreparedRun) -> bool:
    """Whether two runs repeat one condition for as long as both go on."""
    rigs = one.setup.rig, other.setup.rig
    loads = [(each.mass_x, each.mass_z, each.drawbar_load) for each in rigs]
    if not np.allclose(*loads, rtol=0, atol=SAME):
        return False
    sands = [each.setup.terrain.zeta for each in (one, other)]
    known = [np.log(sand) for sand in sands if isinstance(sand, float)]
    if np.ptp(known or [0.0]) > SAME_SAND:
        return False
    a, b = one.setup.command, other.setup.command
    if (a.vx is None) != (b.vx is None):
        return False
    ends = _lasts(one), _lasts(other)
    if min(ends) < LEAST_SHARED * max(ends):
        return False
    # Straight lines agree where they agree at the corners of both.
    times = [np.asarray(each.time) - each.time[0] for each in (a, b)]
    corners = np.union1d(*times)
    corners = corners[corners <= min(ends)]

    def agree(first: Sequence[float], second: Sequence[float], share: float = 0.0) -> bool:
        values = [np.interp(corners, t, v) for t, v in zip(times, (first, second), strict=True)]
        top = float(np.abs(values).max())
        return np.allclose(*values, rtol=0, atol=max(SAME, share * top))

    return agree(a.omega, b.omega) and (a.vx is None or agree(a.vx, b.vx or (), SAME_PACE))
