"""Recorded runs from where the wheel sets off, without its rest before.

A wheel that stands says little of the sand: every zeta from the one that just carries it upward
lets it stand. Yet that bound is a cliff. Below it the simulated wheel falls, and with a horizontal
force on it by half a millimetre at once: turned or pulled ever so little, one face of its lowest
grouser carries in place of two. A rig that came to rest on its sand has its zeta at this very edge,
and no derivative tells on which side. A driven carriage holds its wheel while it stands, and its
load cell reads the weight: there the rest tells something.
"""

from dataclasses import replace

import numpy as np

from drftjax.common.arrays import as_real
from drftjax.recorded.observation import ROUNDING, Observation
from drftjax.recorded.prepared_run import PreparedRun
from drftjax.recorded.start_state import (
    DEFAULT_START,
    StartSettings,
    is_settling,
    rest_duration,
)
from drftjax.runlog.record import RecordedCommand
from drftjax.simulation.trial import Trial


def from_setting_off(each: PreparedRun, settings: StartSettings = DEFAULT_START) -> PreparedRun:
    """A run of a free carriage from the last moment at which the wheel is commanded to rest.

    Its trial and observation count time from there; its set-up stays that of the whole. It starts
    where the wheel stood at last, by the mean of the readings over `settings.window`.

    Args:
        each: Recorded run.
        settings: Which samples give the start, and what counts as motion.

    Returns:
        The same where the carriage is driven, where nothing rests at first, where the wheel was not
        recorded meanwhile or still settles then, where a rest was left out before, and of a run
        that was made in the loop, whose replay counts its log's time.
    """
    trial, seen = each.trial, each.observation
    vx = np.asarray(trial.vx)
    command = RecordedCommand(np.asarray(trial.time), np.asarray(trial.omega), vx)
    begun = rest_duration(command, each.setup.wheel.radius, settings)
    since = seen.time - begun
    rest = (since >= -settings.window - ROUNDING) & (since <= ROUNDING) & seen.after_start
    place = {
        name: (values[rest], noise)
        for name, (values, noise) in seen.by_channel().items()
        if name in ("x", "z")
    }
    stands = begun > 0 and rest.sum() > 1 and each.setup.start.speed == 0
    stands = stands and not is_settling(since[rest], place, settings)
    is_whole = each.rest_left_out == 0 and each.made_in_loop is None
    is_free = each.setup.rig.carriage == "free"
    if not (is_free and is_whole and stands and np.any(since > ROUNDING)):
        return each
    position = np.array(trial.start.position)
    for axis, name in enumerate("xz"):
        if name in place:
            position[axis] = place[name][0].mean()
    time, omega, vx = (_from(command.time, begun, c) for c in (command.time, command.omega, vx))
    step = float(trial.step)
    return replace(
        each,
        trial=Trial.of(
            trial.simulator,
            replace(trial.start, position=as_real(position)),
            RecordedCommand(time - begun, omega, vx),
            step,
            trial.every * step,
        ),
        observation=_observation_from(seen, begun),
        rest_left_out=begun,
    )


def _from(time: np.ndarray, begun: float, values: np.ndarray) -> np.ndarray:
    """Knots of a profile from a time on, with one there."""
    return np.r_[np.interp(begun, time, values), values[time > begun]]


def _observation_from(seen: Observation, begun: float) -> Observation:
    kept = seen.time >= begun - ROUNDING
    return replace(
        seen,
        time=seen.time[kept] - begun,
        values=seen.values[:, kept],
        counts=seen.counts[kept],
        step_error=None if seen.step_error is None else seen.step_error[:, kept],
    )
