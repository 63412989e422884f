"""The wheel at rest: zeroed where it touches the sand, armed, and left to settle.

From ARM on a command to stand goes out on each tick, because the rig's watchdog wants one.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from drftjax.common.errors import InputError
from hils.clock import AbstractClock
from hils.control.measurements import TouchdownZero, longest_silence
from hils.control.stop_request import StopRequest
from hils.link.link import AbstractLink, Arrival
from hils.link.messages import Drive, HelloAck, Measurement
from hils.procedure.session import Session

# Touch-down is averaged over this time [s]. Where fewer readings came than it needs, as to a host
# that was busy elsewhere, it goes on until they have, for so long at most.
TOUCH_DOWN_TIME, LONGEST_TOUCH_DOWN, TOUCH_DOWN_READINGS = 0.5, 2.0, 8


# Standard deviation of the height under which the wheel counts as held still [m].
HELD_STILL = 3e-4


# The wheel is left alone at least so long [s]. It has settled where the mean height changes by less
# from one window to the next [m]. Sand goes on creeping, so what it stands on at the start is told
# again from the last of these windows.
LEAST_SETTLING, SETTLING_WINDOW, SETTLED = 2.0, 0.3, 1e-4


LONGEST_SETTLING = 20.0


# Between rest and start the wheel creeps by no more than this [m].
MOST_CREPT = 2e-3


class RunAborted(Exception):
    """The run is asked to end, or the rig no longer follows, before the profile has begun."""


class SettledWheel(NamedTuple):
    """The wheel at rest on the sand.

    Attributes:
        sinkage: H_static [m].
        noise: Standard deviation of a reading [m].
        creep: How fast it still sank [m/s].
    """

    sinkage: float
    noise: float
    creep: float


def touch_down(
    session: Session, link: AbstractLink, clock: AbstractClock, ack: HelloAck
) -> TouchdownZero:
    """The counts of a wheel that is held where it just touches the sand.

    Raises:
        InputError: where the rig does not measure or has stopped, or the wheel is not held still.
    """
    heights, places = [], []
    begun = clock.now()
    last = _time_of(link.newest())
    while (deadline := begun + _lasts(len(heights))) > clock.now():
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
        heights.append(measurement.z)
        places.append(measurement.x)
    if len(heights) < TOUCH_DOWN_READINGS:
        session.require_not_reset()
        raise InputError(
            f"{link.name}: {len(heights)} measurements came in {LONGEST_TOUCH_DOWN:g} s while the "
            f"wheel was held at touch-down, needs {TOUCH_DOWN_READINGS}; a rig at rest sends one "
            "each 20 ms"
        )
    spread = float(np.std(heights)) * abs(ack.z_scale)
    if spread > HELD_STILL:
        raise InputError(
            f"the height varies by {spread * 1e3:.2f} mm (standard deviation) while the wheel is "
            f"held at touch-down, must be under {HELD_STILL * 1e3:g} mm: hold it still"
        )
    return TouchdownZero(float(np.mean(places)), float(np.mean(heights)), ack.x_scale, ack.z_scale)


def _lasts(readings: int) -> float:
    """How long touch-down is watched, with so many readings [s]."""
    return TOUCH_DOWN_TIME if readings >= TOUCH_DOWN_READINGS else LONGEST_TOUCH_DOWN


class StandingWheel:
    """Keeps the wheel standing from ARM on.

    Args:
        session: Once it is armed.
        link, clock: The rig.
        stop: Looked at on each tick.
        tick: Time from one command to the next [s].
        driven: Whether the carriage is held; else it is free.
        valid_ms: How long the rig may hold a command [ms].
        show: Takes each sinkage measured [m], without waiting.

    Attributes:
        rest: The command to stand.
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
    ):
        self._link, self._clock, self._stop = link, clock, stop
        self._session, self._tick, self._show = session, tick, show
        self.hold_command = Drive(0.0, 0.0, driven, valid_ms)
        self._due = self._heard = clock.now()

    def settle(self, zero: TouchdownZero) -> SettledWheel:
        """Wait until the wheel rests on the sand.

        Raises:
            InputError: it does not come to rest.
        """
        began = self._clock.now()
        times: list[float] = []
        heights: list[float] = []
        creep = math.nan
        for arrival in self._beats(began + LONGEST_SETTLING):
            if arrival is None:
                continue
            times.append(arrival.time)
            heights.append(self._height(arrival, zero))
            if arrival.time - began < LEAST_SETTLING:
                continue
            time, height = np.array(times), np.array(heights)
            late = time > arrival.time - SETTLING_WINDOW
            before = (time > arrival.time - 2 * SETTLING_WINDOW) & ~late
            if before.sum() < 3 or late.sum() < 3:
                continue
            # Medians: an absurd reading or two say nothing.
            sunk = float(np.median(height[before]) - np.median(height[late]))
            creep = sunk / SETTLING_WINDOW
            noise = float(height[late].std())
            if abs(sunk) < SETTLED:
                return SettledWheel(-float(np.median(height[late])), noise, creep)
        raise InputError(
            f"the wheel has not come to rest in {LONGEST_SETTLING:g} s: it still sinks by "
            f"{creep * 1e3:.2g} mm/s"
        )

    def hold(self, until: float, zero: TouchdownZero, settled: SettledWheel) -> float:
        """Stand until this time [s].

        Returns:
            Median sinkage over the last of it [m].

        Raises:
            Ended: the wheel has not stayed where it had settled.
        """
        heights = []
        for arrival in self._beats(until):
            if arrival is None:
                continue
            height = self._height(arrival, zero)
            if arrival.time > until - SETTLING_WINDOW:
                heights.append(height)
        sinkage = -float(np.median(heights)) if heights else settled.sinkage
        sunk = sinkage - settled.sinkage
        if not abs(sunk) <= MOST_CREPT:
            raise RunAborted(
                f"the height has changed by {-sunk * 1e3:.4g} mm between rest and start, "
                f"{MOST_CREPT * 1e3:g} mm at most are believed"
            )
        return sinkage

    def _beats(self, until: float) -> Iterator[Arrival | None]:
        """A command to stand on each tick; what the rig has newly measured, or None.

        Raises:
            Ended: the run is asked to end, or the rig is silent or at fault.
            RigStopped: the rig no longer follows.
        """
        seen = _time_of(self._link.newest())
        self._due = self._heard = self._clock.now()
        while self._clock.now() < until:
            if self._stop.first_reason is not None:
                raise RunAborted(self._stop.reason)
            self._link.send(self.hold_command)
            self._due += self._tick
            if self._due < self._clock.now():  # late: no burst of commands to catch up
                self._due = self._clock.now()
            self._clock.sleep_until(self._due)
            self._session.check()
            arrival = self._link.newest()
            fresh = arrival is not None and arrival.time != seen
            if arrival is not None and fresh:
                seen = self._heard = arrival.time
                self._look_at(arrival)
            silent = self._clock.now() - self._heard
            if silent > longest_silence(self._tick):
                raise RunAborted(f"the rig has sent no measurement for {silent:.2f} s")
            yield arrival if fresh else None

    def _height(self, arrival: Arrival, zero: TouchdownZero) -> float:
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        height = zero.reading(measurement, arrival.time).z
        self._show(-height)
        return height

    def _look_at(self, arrival: Arrival) -> None:
        measurement = arrival.frame.message
        assert isinstance(measurement, Measurement)
        if measurement.fault:
            raise RunAborted(f"the rig reports fault {measurement.fault}")


def _time_of(arrival: Arrival | None) -> float:
    return -math.inf if arrival is None else arrival.time
