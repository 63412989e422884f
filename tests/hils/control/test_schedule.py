"""Times of the ticks on a real clock: the step beforehand comes before the tick, and only there."""

import time

from hils.clock import MonotonicClock, VirtualClock
from hils.control.schedule import WARM_UP, TickSchedule


def test_a_step_is_made_shortly_before_a_tick_where_there_is_time():
    clock = MonotonicClock()
    schedule = TickSchedule(clock, 0.05)
    schedule.begin(clock.now())
    assert not schedule.wait_to_warm_up(0)  # it is due
    assert schedule.wait_to_warm_up(1)
    left = schedule.sleep_until(1) - clock.now()
    assert -0.05 < left <= WARM_UP
    time.sleep(0.06)
    assert not schedule.wait_to_warm_up(2)  # the tick is late already


def test_short_ticks_and_virtual_time_have_none():
    fast = TickSchedule(MonotonicClock(), 0.001)
    fast.begin(time.monotonic())
    assert not fast.wait_to_warm_up(1000)
    virtual = TickSchedule(VirtualClock(), 0.05)
    virtual.begin(0.0)
    assert not virtual.wait_to_warm_up(1)
