"""The wheel at rest: zeroed where it touches the sand, armed, and left to settle.

From ARM on a command to stand goes out on each tick, because the rig's watchdog wants one.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.control.measurements import DEFAULT_RESPONSE, ResponseSettings, TouchdownZero
from hils.control.safety import DEFAULT_SAFETY, MotionAtRest, SafetySettings
from hils.control.stop_request import StopReason, StopRequest
from hils.link.link import AbstractLink, Arrival
from hils.link.messages import EMERGENCY, Drive, HelloAck, Measurement
from hils.procedure.session import Session


@dataclass(frozen=True)
class TouchdownSettings:
    """Zeroing of a wheel that is held where it touches the sand.

    Attributes:
        averaging_time: Time over which the counts are averaged [s].
        min_readings: Readings that the average needs; where fewer came, as to a host that was busy
            elsewhere, it goes on until they have.
        longest_time: Time after which it gives up [s].
        max_noise: Standard deviation of the height under which the wheel counts as held still [m].
    """

    averaging_time: float = 0.5
    min_readings: int = 8
    longest_time: float = 2.0
    max_noise: float = 3e-4

    def duration(self, readings: int) -> float:
        """Time for which the wheel is watched [s], by the readings that have come."""
        return self.averaging_time if readings >= self.min_readings else self.longest_time


DEFAULT_TOUCHDOWN = TouchdownSettings()


@dataclass(frozen=True)
class SettlingSettings:
    """Settling of the wheel on the sand, and its creep until the start.

    Attributes:
        min_time: Time for which the wheel is left alone, at least [s].
        window: Length of the two windows, one after the other, whose median heights are compared
            [s]. Sand goes on creeping, so the sinkage at the start is measured again over the last
            window before it.
        max_change: Change of the height from one window to the next under which the wheel has
            settled [m].
        longest_time: Time after which it gives up [s].
        max_creep: Change of the height between rest and start that is believed [m].
    """

    min_time: float = 2.0
    window: float = 0.3
    max_change: float = 1e-4
    longest_time: float = 20.0
    max_creep: float = 2e-3


DEFAULT_SETTLING = SettlingSettings()


class RunAborted(Exception):
    """The run is asked to end, or the rig no longer follows, before the profile has begun."""


class SettledWheel(NamedTuple):
    """The wheel at rest on the sand.

    Attributes:
        sinkage: H_static [m].
        noise: Standard deviation of a reading [m].
        creep: Speed at which it still sank [m/s].
        repeated: Share of the readings that equal the one before [-].
        interval: From one reading to the next [s].
        omega_measured: True where the rig measures its wheel's speed.
    """

    sinkage: float
    noise: float
    creep: float
    repeated: float = 1.0
    interval: float = math.inf
    omega_measured: bool = True


def touch_down(
    session: Session,
    link: AbstractLink,
    clock: AbstractClock,
    ack: HelloAck,
    settings: TouchdownSettings = DEFAULT_TOUCHDOWN,
    safety: SafetySettings = DEFAULT_SAFETY,
) -> TouchdownZero:
    """Average the counts of a wheel that is held where it just touches the sand.

    Raises:
        InputError: the rig does not measure, has stopped or moves by itself, or the wheel is not
            held still.
        LinkLost: the line broke.
    """
    heights, travels = [], []
    motion = MotionAtRest(ack.x_scale, safety)
    begun = clock.now()
    last = _time_of(link.newest())
    while (deadline := begun + settings.duration(len(heights))) > clock.now():
        link.wait(deadline)
        session.require_no_rig_stop()
        arrival = link.newest()
        if arrival is None or _time_of(arrival) == last:
            continue
        last = arrival.time
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if measurement.fault:
            raise InputError(f"{link.name}: the rig reports fault {measurement.fault}")
        if (moves := motion.find(measurement.omega, measurement.x)) is not None:
            session.emergency_stop(EMERGENCY)
            raise InputError(f"{link.name}: {moves.sentence}, before it was armed: switch it off")
        heights.append(measurement.z)
        travels.append(measurement.x)
    if len(heights) < settings.min_readings:
        session.require_not_reset()
        raise InputError(
            f"{link.name}: {len(heights)} measurements came in {settings.longest_time:g} s while "
            f"the wheel was held at touch-down, needs {settings.min_readings}; a rig at rest sends "
            "one each 20 ms"
        )
    noise = float(np.std(heights)) * abs(ack.z_scale)
    if noise > settings.max_noise:
        raise InputError(
            f"the height varies by {noise * 1e3:.2f} mm (standard deviation) while the wheel is "
            f"held at touch-down, must be under {settings.max_noise * 1e3:g} mm: hold it still"
        )
    return TouchdownZero(float(np.mean(travels)), float(np.mean(heights)), ack.x_scale, ack.z_scale)


class StandingWheel:
    """Keeps the wheel standing from ARM on.

    Args:
        session: Once it is armed.
        link, clock: The rig.
        stop: Requests to end the run, checked on each tick.
        tick: Time from one command to the next [s].
        driven: True where the carriage is held; else it is free.
        valid_ms: Time for which the rig may hold a command [ms].
        show: Takes each sinkage measured [m], without waiting.
        settings: Settling and creep.
        response: Patience with a silent rig.
        motion: Looks for motion of the wheel or the carriage.

    Attributes:
        hold_command: The command to stand.
    """

    def __init__(
        self,
        session: Session,
        link: AbstractLink,
        clock: AbstractClock,
        stop: StopRequest,
        tick: float,
        driven: bool,
        valid_ms: int,
        show: Callable[[float], None],
        settings: SettlingSettings = DEFAULT_SETTLING,
        response: ResponseSettings = DEFAULT_RESPONSE,
        motion: MotionAtRest | None = None,
    ):
        self._link, self._clock, self._stop, self._motion = link, clock, stop, motion
        self._session, self._tick, self._show = session, tick, show
        self._settings, self._longest_silence = settings, response.longest_silence(tick)
        self.hold_command = Drive(0.0, 0.0, driven, valid_ms)

    def settle(self, zero: TouchdownZero) -> SettledWheel:
        """Wait until the wheel rests on the sand.

        Raises:
            InputError: it does not come to rest.
            RunAborted: the run is asked to end, or the rig is silent or at fault.
            RigStopped: the rig no longer follows.
            LinkLost: the line broke.
        """
        settings, began = self._settings, self._clock.now()
        times: list[float] = []
        heights: list[float] = []
        creep, turning = math.nan, math.nan
        for arrival in self._command_each_tick(began + settings.longest_time):
            if arrival is None:
                continue
            times.append(arrival.time)
            heights.append(self._height(arrival, zero))
            turning = _measurement(arrival).omega
            if arrival.time - began < settings.min_time:
                continue
            windows = self._last_windows(np.array(times), np.array(heights))
            if windows is None:
                continue
            before, late = windows
            # Medians: an absurd reading or two say nothing.
            sunk = float(np.median(before) - np.median(late))
            creep = sunk / settings.window
            if abs(sunk) < settings.max_change:
                repeated = float((np.diff(late) == 0).mean())
                interval = float(np.diff(times[-len(late) :]).mean())
                noise, measured = float(late.std()), math.isfinite(turning)
                sinkage = -float(np.median(late))
                return SettledWheel(sinkage, noise, creep, repeated, interval, measured)
        raise InputError(
            f"the wheel has not come to rest in {settings.longest_time:g} s: it still sinks by "
            f"{creep * 1e3:.2g} mm/s"
        )

    def _last_windows(
        self, time: NDArray[np.float64], height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Heights in the last window but one and in the last, where each holds three or more."""
        window = self._settings.window
        late = time > time[-1] - window
        before = (time > time[-1] - 2 * window) & ~late
        if before.sum() < 3 or late.sum() < 3:
            return None
        return height[before], height[late]

    def hold(self, until: float, zero: TouchdownZero, settled: SettledWheel) -> float:
        """Stand until this time [s].

        Returns:
            Median sinkage over the last of it [m].

        Raises:
            RunAborted: the wheel has not stayed where it had settled, or as `settle`.
            RigStopped: the rig no longer follows.
            LinkLost: the line broke.
        """
        heights = []
        for arrival in self._command_each_tick(until):
            if arrival is None:
                continue
            height = self._height(arrival, zero)
            if arrival.time > until - self._settings.window:
                heights.append(height)
        sinkage = -float(np.median(heights)) if heights else settled.sinkage
        sunk, most = sinkage - settled.sinkage, self._settings.max_creep
        if not abs(sunk) <= most:
            raise RunAborted(
                f"the height has changed by {-sunk * 1e3:.4g} mm between rest and start, "
                f"{most * 1e3:g} mm at most are believed"
            )
        return sinkage

    def _command_each_tick(self, until: float) -> Iterator[Arrival | None]:
        """Command to stand on each tick; the rig's new measurement, or None.

        Raises:
            RunAborted: the run is asked to end, or the rig is silent or at fault.
            RigStopped: the rig no longer follows.
        """
        seen = _time_of(self._link.newest())
        due = heard = self._clock.now()
        while self._clock.now() < until:
            if self._stop.first_reason is not None:
                raise RunAborted(self._stop.reason)
            self._link.send(self.hold_command)
            # Where it is late: no burst of commands to catch up.
            due = max(due + self._tick, self._clock.now())
            self._clock.sleep_until(due)
            self._session.check()
            arrival = self._link.newest()
            fresh = arrival is not None and arrival.time != seen
            if arrival is not None and fresh:
                seen = heard = arrival.time
                self._require_sound(_measurement(arrival))
            silent = self._clock.now() - heard
            if silent > self._longest_silence:
                raise RunAborted(f"the rig has sent no measurement for {silent:.2f} s")
            yield arrival if fresh else None

    def _require_sound(self, measurement: Measurement) -> None:
        """Refuse a rig at fault, one that moves, and one whose readings come too late."""
        if measurement.fault:
            raise RunAborted(f"the rig reports fault {measurement.fault}")
        moves = None
        if self._motion is not None:
            moves = self._motion.find(measurement.omega, measurement.x)
        if moves is not None:
            reason = StopReason(moves.sentence, moves.rule.event, moves.value)
            self._stop.ask(reason, emergency=True)
            raise RunAborted(moves.sentence)
        sent = self._link.sent_at(measurement.ack_seq)
        age = 0.0 if sent is None else self._clock.now() - sent
        if age > self._longest_silence:
            raise RunAborted(
                f"the rig's newest reading is {age:.2f} s old, {self._longest_silence:.2g} s are "
                "allowed: something holds the line's bytes back"
            )

    def _height(self, arrival: Arrival, zero: TouchdownZero) -> float:
        height = zero.reading(_measurement(arrival), arrival.time).z
        self._show(-height)
        return height


def _measurement(arrival: Arrival) -> Measurement:
    measurement = arrival.frame.message
    assert isinstance(measurement, Measurement)
    return measurement


def _time_of(arrival: Arrival | None) -> float:
    return -math.inf if arrival is None else arrival.time
