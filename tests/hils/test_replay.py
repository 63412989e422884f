"""A run made from its own readings again: the same zeta, whatever happened on the way."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import RunLog
from hils.events import TickFlag
from hils.replay import replay
from tests.helpers.replayable_run import PROFILE, record_run

# As the test's own process has it: what other tests set meanwhile may make other kernels.
ENVIRONMENT = dict(os.environ)
ROOT = Path(__file__).resolve().parents[2]

# Within the run, which starts some 6 s after the rig's power-up.
BUSY_AT = (7.0, 7.5, 7.6)


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("replay") / "run.h5"


@pytest.fixture(scope="module")
def log(path) -> RunLog:
    return record_run(path)


def test_the_run_has_what_makes_a_replay_hard(log):
    flags, online = log.online.flags, log.online
    assert ((flags & TickFlag.FRESH) == 0).sum() > 5  # ticks without a reading
    assert ((flags & TickFlag.REFUSED) > 0).sum() > 2
    assert (np.diff(online.zeta) > 0).any()
    assert (np.diff(online.zeta) < 0).any()
    assert log.end_reason == "completed"


def test_a_replay_gives_the_recorded_zeta_bit_for_bit(log):
    made = replay(log)
    assert made.zeta.tobytes() == log.online.zeta.tobytes()
    assert made.exact
    assert made.ticks == log.online.time.size
    assert "bit for bit" in made.sentence()


def test_another_process_gives_the_recorded_zeta_bit_for_bit(log, path):
    code = (
        "import sys; from drftjax.runlog.hdf5.api import read_run; from hils.replay import replay; "
        "made = replay(read_run(sys.argv[1])); print(made.exact, made.zeta.tobytes().hex())"
    )
    said = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        check=True,
        env=ENVIRONMENT,
        cwd=ROOT,
    ).stdout.split()
    assert said == ["True", log.online.zeta.tobytes().hex()]


@pytest.mark.parametrize("tuner", ["pi", "kalman"])
def test_every_tuner_is_replayed_bit_for_bit(tmp_path, tuner):
    assert replay(record_run(tmp_path / "run.h5", tuner)).exact


def test_skipped_ticks_are_replayed_bit_for_bit(tmp_path):
    log = record_run(tmp_path / "run.h5", busy_at=BUSY_AT)
    numbers = np.round(log.online.time / log.online.tick)
    assert (np.diff(numbers) > 1).sum() == 3
    assert ((log.online.flags & TickFlag.SKIPPED) > 0).sum() == 3
    assert replay(log).exact


def test_a_run_ended_early_is_replayed_bit_for_bit(tmp_path):
    log = record_run(tmp_path / "run.h5", stop_above=0.3)
    assert log.end_reason == "asked to stop"
    assert ((log.online.flags & TickFlag.RAMPING) > 0).any()
    assert log.online.time[-1] < PROFILE[0][-1]
    assert replay(log).exact


def test_a_run_cut_off_is_replayed_as_far_as_it_goes(log):
    rows = log.online.time.size // 2
    columns = {
        each.name: getattr(log.online, each.name)
        for each in dataclasses.fields(log.online)
        if isinstance(getattr(log.online, each.name), np.ndarray)
    }
    half = dataclasses.replace(log.online, **{name: each[:rows] for name, each in columns.items()})
    made = replay(dataclasses.replace(log, online=half))
    assert made.exact
    assert made.ticks == rows


def changed(log: RunLog, **columns) -> RunLog:
    return dataclasses.replace(log, online=dataclasses.replace(log.online, **columns))


def test_readings_that_were_others_are_noticed_from_their_first_tick_on(log):
    z = log.measured.z.copy()
    row = z.size // 3
    z[row:] += 1e-3
    made = replay(dataclasses.replace(log, measured=dataclasses.replace(log.measured, z=z)))
    assert not made.exact
    assert {each.name for each in made.differences} >= {"zeta", "z_sim"}
    when = log.measured.time[row]
    assert all(each.first >= when for each in made.differences)


@pytest.mark.parametrize("name", ["zeta", "x_sim", "z_sim", "vx_sim", "fx_sim", "fz_sim"])
def test_the_last_bit_of_one_recorded_number_is_noticed(log, name):
    values = getattr(log.online, name).copy()
    values[20] = np.nextafter(values[20], np.inf)
    (found,) = replay(changed(log, **{name: values})).differences
    assert (found.name, found.rows, found.first) == (name, 1, log.online.time[20])
    assert found.largest == values[20] - getattr(log.online, name)[20]


def test_a_run_recorded_without_fz_sim_is_replayed(log):
    assert replay(changed(log, fz_sim=None)).exact


def test_a_command_that_was_another_is_noticed(log):
    vx = log.command.vx.copy()
    vx[30] += 1e-3
    made = replay(dataclasses.replace(log, command=dataclasses.replace(log.command, vx=vx)))
    (found,) = made.differences
    assert (found.name, found.rows) == ("vx", 1)
    assert f"vx differs in 1 rows from {log.command.time[30]:g} s on" in made.sentence()


def test_what_cannot_be_replayed_is_refused_with_its_reason(log):
    with pytest.raises(InputError, match="was not made in the loop"):
        replay(dataclasses.replace(log, online=None))
    with pytest.raises(InputError, match="no attribute loop"):
        replay(changed(log, loop=None))
    with pytest.raises(InputError, match="record of its loop cannot be read"):
        replay(changed(log, loop='{"loop": 1}'))
    with pytest.raises(InputError, match=r"tick 0\.02 s, its loop has 0\.01 s"):
        replay(changed(log, tick=0.02))
    with pytest.raises(InputError, match="no whole number of ticks"):
        replay(changed(log, time=log.online.time + 1e-6))
    with pytest.raises(InputError, match="no row for the reading"):
        replay(changed(log, flags=log.online.flags | TickFlag.FRESH))


def test_the_command_says_how_every_run_came_out(drft, log, path, tmp_path):
    good = drft("hils", "replay", path)
    assert good.code == 0, good
    assert good.out.startswith(f"{path}: {log.online.time.size} ticks: zeta, ")
    zeta = log.online.zeta.copy()
    zeta[-1] += 1e-9
    other = tmp_path / "other.h5"
    write_run(other, changed(log, zeta=zeta))
    both = drft("hils", "replay", path, other)
    assert both.code == 1
    assert f"{other}: {log.online.time.size} ticks: zeta differs in 1 rows" in both.out
    write_run(other, dataclasses.replace(log, online=None))
    assert (
        drft("hils", "replay", other).refusal
        == f"{other}: the run has no /online: it was not made in the loop"
    )
    assert jax.config.values["jax_enable_x64"]
