"""Readings that the loop refused do not reach a fit: a scale that jumps spoils no zeta."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.recorded.gather import gather
from drftjax.recorded.prepared_run import prepare_run
from drftjax.recorded.refused_readings import drop_refused, refused_readings
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.record import RunLog
from hils.events import TickFlag
from tests.helpers.replayable_run import record_run

# The wheel sinks by 14 mm in this run; an absurd reading is off by 30 mm and more [m].
ABSURD = 0.025


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("refused") / "run.h5"
    record_run(path)
    return path


@pytest.fixture(scope="module")
def log(path) -> RunLog:
    return read_run(path)


def flagged(log: RunLog) -> int:
    return int(((log.online.flags & TickFlag.REFUSED) > 0).sum())


def test_what_the_loop_refused_is_not_compared(log):
    refused = refused_readings(log)
    assert refused.sum() == flagged(log) > 2
    off = np.abs(log.measured.z - np.median(log.measured.z))
    assert off[refused].min() > ABSURD > off[~refused].max()
    seen = prepare_run("run", log).observation
    assert set(seen.time) <= set(log.measured.time[~refused] - log.command.time[0])
    assert np.ptp(seen.by_channel()["z"][0]) < ABSURD


def test_the_operator_is_told_how_many_there_were(log, path):
    told: list[str] = []
    gather([path], tell=told.append)
    assert told == [
        f"run: {flagged(log)} readings, which the loop refused or doubted, are not compared"
    ]


def test_all_readings_stay_where_a_log_does_not_tell_which(log):
    measured = log.measured
    cut = measured.select(np.arange(measured.time.size) < measured.time.size - 1)
    online = dataclasses.replace(log.online, meanings={})
    for each in (
        dataclasses.replace(log, measured=cut),
        dataclasses.replace(log, online=online),
        dataclasses.replace(log, online=None, events=None),
    ):
        assert drop_refused(each) is each


def test_a_free_run_tells_them_by_its_events(log):
    free = dataclasses.replace(log, online=None)
    np.testing.assert_array_equal(refused_readings(free), refused_readings(log))


def test_a_run_of_refused_readings_alone_cannot_be_used(log):
    online = dataclasses.replace(log.online, flags=log.online.flags | TickFlag.REFUSED)
    with pytest.raises(InputError, match="the loop refused all its readings"):
        prepare_run("run", dataclasses.replace(log, online=online))


def test_a_stuck_scale_is_left_out_from_its_last_change_on(log):
    """Its readings are flagged later than they are wrong."""
    z = log.measured.z.copy()
    z[40:60] = z[40]
    fresh = np.flatnonzero(log.online.flags & TickFlag.FRESH)
    flags = log.online.flags.copy()
    flags[fresh[50:60]] |= np.uint32(TickFlag.STUCK)
    stuck = dataclasses.replace(
        log,
        measured=dataclasses.replace(log.measured, z=z),
        online=dataclasses.replace(log.online, flags=flags),
    )
    found = refused_readings(stuck) & ~refused_readings(log)
    assert found[40:60].sum() == 20 - refused_readings(log)[40:60].sum()
    assert found.sum() <= 20
