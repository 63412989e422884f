"""A line that holds all back alike: readings come fresh every tick, and are old all the same."""

from pathlib import Path

import numpy as np
import pytest

from hils.events import Event, TickFlag
from hils.replay import replay
from hils.rig_sim.faults import DelayedFrames, Fault, Window
from hils.series import outcome_lines
from tests.helpers.fault_matrix import Cell, require_safety, struck

# Five ticks are 100 ms.
LATE, IN_TIME = 0.15, 0.04


def delayed(delay: float) -> Cell:
    return struck((Fault(DelayedFrames(towards="host", delay=delay), Window("hello", 0.0)),))


@pytest.fixture(scope="module")
def late() -> Cell:
    return delayed(LATE)


def test_zeta_does_not_follow_them(late):
    require_safety(late)
    assert late.report is not None
    assert late.report.completed, late.report.reason
    online = late.rows.run().online
    assert online is not None
    fresh = (online.flags & TickFlag.FRESH) != 0
    old = (online.flags & TickFlag.OLD) != 0
    assert fresh.mean() > 0.9
    assert old[fresh].all()
    assert np.ptp(online.zeta) == 0
    # By their arrival nobody would know. Half of the round trip is counted, as it is not known how
    # much of it was on the way back.
    assert LATE / 2 <= np.median(online.age) <= LATE
    assert Event.READINGS_STALE in late.events
    count = np.count_nonzero(old)
    (said,) = (
        each for each in outcome_lines(late.report, Path("run.h5")) if "zeta was held" in each
    )
    assert said.startswith(f"{count} readings answered a command")


def test_they_are_recorded_and_replayed(late):
    log = late.rows.run()
    assert log.online is not None
    assert log.measured.time.size == np.count_nonzero(log.online.flags & TickFlag.FRESH)
    assert replay(log).exact


def test_readings_that_come_a_little_late_are_followed():
    little = delayed(IN_TIME)
    online = little.rows.run().online
    assert online is not None
    assert not (online.flags & TickFlag.OLD).any()
    assert np.ptp(online.zeta) > 0
