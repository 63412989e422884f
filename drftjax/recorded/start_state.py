"""Start of a recorded run: sinkage and place of the wheel when its command begins.

Both are read from the samples that were taken at rest, before wheel or carriage sets off. A wheel
creeps into the sand while it stands, so over a long rest a polynomial through the sinkage gives its
value at the start; over a short one their mean does.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from drftjax.recorded.observation import DEFAULT_OBSERVATION, ObservationSettings, instrument_noise
from drftjax.runlog.record import Measured, RecordedCommand, RunLog
from drftjax.setups.setup import SetUp, StartSetUp


@dataclass(frozen=True)
class StartSettings:
    """Numbers that decide which samples give the start, and by which curve.

    Attributes:
        window: Length of the rest that sinkage and place are averaged over [s].
        creep_window: Length of the rest that a creeping sinkage is fitted over [s]; a wheel that
            sets off sooner has its mean.
        min_samples: Samples that a fit needs; fewer make no line that is better than their mean.
        curvature_errors: Curvature of the creep, in its standard errors, from which on a parabola
            is fitted; noise that lasts over a few samples makes four.
        settling_errors: Slope, in its standard errors, from which on a wheel still settles and its
            first sample alone is taken; slow errors of instruments reach ten.
        settling_distance: Motion over the window that such a slope must amount to as well [m].
        still_distance: Motion of a measured or rounded command that counts as rest [m]: less than
            scales resolve.
    """

    window: float = 0.2
    creep_window: float = 0.5
    min_samples: int = 10
    curvature_errors: float = 6.0
    settling_errors: float = 30.0
    settling_distance: float = 2e-4
    still_distance: float = 1e-5


DEFAULT_START = StartSettings()


def start_state(
    run: RunLog,
    setup: SetUp,
    settings: StartSettings = DEFAULT_START,
    noise: ObservationSettings = DEFAULT_OBSERVATION,
) -> StartSetUp:
    """Start of a recorded run: the set-up's, with sinkage and x as they were recorded at rest.

    Args:
        run: Recorded run, without refused readings; a sample at or after its first command.
        setup: Its set-up; gives the rim radius, and what was not recorded.
        settings: Which samples count, and by which curve.
        noise: Resolution of the instruments.
    """
    rest = rest_duration(run.command, setup.wheel.radius, settings)
    time, early = _early_samples(run, rest, settings, noise)
    begun, first = time >= -noise.clock_rounding, time[early][0]
    at_rest = early.sum() > 1 or rest < settings.window
    if is_settling(time[early], _place(run.measured, early, noise), settings):
        early = time == first
    start = msgspec.structs.replace(setup.start)
    x, z = run.measured.x, run.measured.z
    if z is not None and at_rest:
        height = float(z[early].mean())
        creeping = begun & (time <= settings.creep_window)
        stands = rest >= settings.creep_window
        if stands and early.sum() > 1 and creeping.sum() >= settings.min_samples:
            height = _creep_start(time[creeping], z[creeping], settings, noise)
        start.sinkage = -height
    if x is not None and at_rest:
        start.x = float(x[early].mean())
    return start


def settles_at_first(
    run: RunLog,
    radius: float,
    settings: StartSettings = DEFAULT_START,
    noise: ObservationSettings = DEFAULT_OBSERVATION,
) -> bool:
    """True where a wheel that is commanded to rest moves by more than its instruments' noise.

    Arguments as for `start_state`, with the rim radius [m].
    """
    rest = rest_duration(run.command, radius, settings)
    time, early = _early_samples(run, rest, settings, noise)
    return is_settling(time[early], _place(run.measured, early, noise), settings)


def _early_samples(
    run: RunLog, rest: float, settings: StartSettings, noise: ObservationSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Times from the first command on [s], and which samples may give the start.

    Returns:
        Both of shape (samples,).
    """
    time = run.measured.time - run.command.time[0]
    begun = time >= -noise.clock_rounding
    # Of a wheel that sets off sooner, no more than its rest gives the start.
    window = min(settings.window, rest) + noise.clock_rounding
    return time, begun & (time <= max(window, time[begun][0]))


def rest_duration(
    command: RecordedCommand, radius: float, settings: StartSettings = DEFAULT_START
) -> float:
    """Time from the first command up to which neither wheel nor carriage is commanded to move [s].

    Args:
        command: Of a run.
        radius: Rim radius [m].
        settings: Motion that counts as rest.
    """
    speeds = np.stack(
        [radius * command.omega, 0 * command.omega if command.vx is None else command.vx]
    )
    steps = np.diff(command.time) * (speeds[:, 1:] + speeds[:, :-1]) / 2
    moved = np.abs(np.cumsum(steps, axis=1)).max(axis=0) > settings.still_distance
    last = int(np.argmax(moved)) if moved.any() else len(moved)
    return float(command.time[last] - command.time[0])


def is_settling(
    time: np.ndarray,
    place: Mapping[str, tuple[np.ndarray, float]],
    settings: StartSettings = DEFAULT_START,
) -> bool:
    """True where the wheel moves by more than its instruments' noise.

    Args:
        time: Of a few samples at rest [s], shape (samples,).
        place: Their x and z [m], as far as they were recorded, each of shape (samples,), with the
            standard deviation of its noise [m].
        settings: Slope that counts as motion.
    """
    if len(time) < 3:
        return False
    since = time - time.mean()
    spread = since @ since
    for values, noise in place.values():
        least = settings.settling_errors * noise / np.sqrt(spread)
        slope = abs(since @ values) / spread
        if slope > max(least, settings.settling_distance / np.ptp(time)):
            return True
    return False


def _place(
    measured: Measured, samples: np.ndarray, noise: ObservationSettings
) -> dict[str, tuple[np.ndarray, float]]:
    """x and z of some samples, as far as they were recorded, with their noise over the run."""
    both = {"x": measured.x, "z": measured.z}
    return {
        name: (values[samples], instrument_noise(name, values, noise))
        for name, values in both.items()
        if values is not None
    }


def _creep_start(
    time: np.ndarray, height: np.ndarray, settings: StartSettings, noise: ObservationSettings
) -> float:
    """Height of a creeping wheel at the first sample [m], by a line or a parabola through all.

    Args:
        time: Of the samples while it stood [s], shape (samples,).
        height: Recorded height [m], shape (samples,).
        settings: Curvature from which on a parabola is fitted.
        noise: Resolution of the instruments.
    """
    powers = np.vander(time - time[0], 3)
    (curvature, _, at_first), square, *_ = np.linalg.lstsq(powers, height)
    scatter = max(float(np.sqrt(square.sum() / (len(time) - 3))), noise.min_noise["z"])
    error = scatter * np.sqrt(np.linalg.inv(powers.T @ powers)[0, 0])
    if abs(curvature) < settings.curvature_errors * error:
        at_first = np.polyfit(powers[:, 1], height, 1)[1]
    return float(at_first)
