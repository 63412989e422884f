"""Kills, hangs and full disks: no committed row is lost, and the loop never waits."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.check import read_run_guarded
from drftjax.runlog.hdf5.api import read_run
from drftjax.runlog.recording_lock import part_path
from drftjax.runlog.repair import CUT_OFF, repair
from hils.recording import recorder as recorder_module
from hils.recording.recorder import Recorder, RecorderSettings
from tests.helpers.recording_host import (
    DEADLINE,
    Host,
    await_outcome,
    committed,
    example_head,
    hand_over,
    recorded,
    repaired,
    trial,
    wrong_rows,
)

# Kills at random times of each kind; tests/benchmarks/kills.py makes 200.
KILLS = 2


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "run.h5"


# Kills -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("victims", [("host",), ("recorder",), ("host", "recorder")])
def test_no_committed_row_is_lost_by_a_kill(tmp_path, victims):
    dice = random.Random(len(victims) + ord(victims[0][0]))
    for number in range(KILLS):
        folder = tmp_path / str(number)
        folder.mkdir()
        wanted, kept, wrong = trial(folder, victims, dice)
        assert kept >= wanted > 0
        assert wrong == 0


def test_a_killed_host_leaves_a_closed_run_log(path):
    host = Host(path)
    host.wait_for_commits(100)
    _, handed, _ = host.kill("host")
    await_outcome(path.exists)
    run = read_run_guarded(path)
    assert run.online.time.size >= handed >= 100
    assert run.end_reason == "the control program ended without closing the recording"
    await_outcome(lambda: not host.part.exists())


FORKING_HOST = """
import os, sys, time
sys.path[:0] = sys.argv[2:]
from tests.helpers.recording_host import example_head, hand_over
from hils.recording import recorder as recorder_module
from hils.recording import recorder as recorder_module
from hils.recording.recorder import Recorder, RecorderSettings
recorder = Recorder(sys.argv[1], example_head())
for number in range(50):
    hand_over(recorder, number)
child = os.fork()
if child:
    print(child, flush=True)
    os.kill(os.getpid(), 9)
time.sleep(600)
"""


def test_a_forked_copy_of_the_pipe_does_not_keep_a_dead_hosts_recording_open(path):
    host = subprocess.Popen(
        [sys.executable, "-c", FORKING_HOST, path, Path(__file__).parents[3]],
        stdout=subprocess.PIPE,
    )
    assert host.stdout is not None
    child = int(host.stdout.readline())
    try:
        host.wait(DEADLINE)
        await_outcome(lambda: path.exists() and not part_path(path).exists())
    finally:
        os.kill(child, signal.SIGKILL)
        host.stdout.close()
    run = read_run(path)
    assert run.online.time.size == 50
    assert run.end_reason.startswith("the control program ended")


def test_a_lost_recorder_is_noticed_by_the_next_row(path):
    recorder = recorded(path, 5)
    os.kill(recorder.pid, signal.SIGKILL)
    recorder._process.wait(DEADLINE)
    assert recorder.alive
    hand_over(recorder, 5)
    assert not recorder.alive
    assert recorder.reason == "ended unasked"


def test_a_recorder_that_hangs_never_holds_the_loop_up(path):
    recorder = recorded(path, 100)
    await_outcome(lambda: committed(part_path(path)) == 100)
    os.kill(recorder.pid, signal.SIGSTOP)
    number = 100
    while recorder.alive:  # a call that waited would wait for ever
        hand_over(recorder, number)
        number += 1
        assert number < 100_000
    assert "pipe to it is full" in recorder.reason
    os.kill(recorder.pid, signal.SIGCONT)
    with pytest.raises(InputError, match=f"pipe to it is full; .* in {path}"):
        recorder.close("the recorder was lost")
    run = read_run(path)
    assert run.online.time.size >= number - 2
    assert wrong_rows(run) == 0
    assert run.end_reason == "the recorder was lost"


def hand_over_slowly(recorder: Recorder, number: int, seconds: float) -> int:
    """At 100 Hz, while the recorder lives; the next tick."""
    end = time.monotonic() + seconds
    while recorder.alive and time.monotonic() < end:
        hand_over(recorder, number)
        number += 1
        time.sleep(0.01)
    return number


def test_a_recorder_that_hangs_is_noticed_though_its_pipe_has_room(path):
    recorder = recorded(path, 100, RecorderSettings(check_interval=0.05))
    await_outcome(lambda: committed(part_path(path)) == 100)
    os.kill(recorder.pid, signal.SIGSTOP)
    number = hand_over_slowly(recorder, 100, DEADLINE)
    assert recorder.reason == "took no rows for 0.8 s"
    assert number < 1000  # of 6000 that the pipe holds
    for each in range(number, number + 50):  # the wheel ramps down
        hand_over(recorder, each)
    os.kill(recorder.pid, signal.SIGCONT)
    with pytest.raises(InputError, match=f"took no rows for 0.8 s; the rows .* in {path}"):
        recorder.close("the recorder was lost")
    run = read_run(path)
    assert run.online.time.size == number + 50
    assert wrong_rows(run) == 0
    assert run.end_reason == "the recorder was lost"


SLOW_DISK = """
import time
from drftjax.runlog.hdf5.recording import Recording
Recording.sync = lambda recording: time.sleep(3)
"""


def test_a_slow_disk_is_no_recorder_that_hangs(path, monkeypatch):
    start = recorder_module._START.replace("from hils", f"exec({SLOW_DISK!r}); from hils")
    monkeypatch.setattr(recorder_module, "_START", start)
    recorder = Recorder(path, example_head(), RecorderSettings(check_interval=0.1))
    number = hand_over_slowly(recorder, 0, 3.5)
    assert recorder.alive
    recorder.close("completed")
    assert read_run(path).online.time.size == number


def test_a_computer_that_was_asleep_is_no_recorder_that_hangs(path):
    recorder = recorded(path, 100, RecorderSettings(check_interval=0.05))
    await_outcome(lambda: committed(part_path(path)) == 100)
    os.kill(recorder.pid, signal.SIGSTOP)
    for number in (100, 101):
        hand_over(recorder, number)
        time.sleep(1.5)
    assert recorder.alive
    os.kill(recorder.pid, signal.SIGCONT)
    recorder.close("completed")
    assert read_run(path).online.time.size == 102


def test_a_head_longer_than_the_pipe_is_refused_beforehand_and_told_as_such(path):
    recorder = Recorder(path, settings=RecorderSettings(pipe_bytes=2**16))
    head = example_head(notes="a profile of many knots" * 10_000)
    recorder.require_room(example_head())
    with pytest.raises(InputError, match="give a profile of fewer knots"):
        recorder.require_room(head)
    recorder.begin(head)
    assert recorder.reason.startswith("was given a head of 23")
    with pytest.raises(InputError, match="more than its pipe could take"):
        recorder.close("completed")
    assert list(path.parent.iterdir()) == []


def test_ctrl_c_and_sigterm_do_not_end_the_recorder(path):
    recorder = recorded(path, 5)
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(recorder.pid, each)
    hand_over(recorder, 5)
    assert recorder.close("interrupted") == path
    assert read_run(path).online.time.size == 6


def test_a_chunk_torn_by_a_kill_still_gives_its_committed_rows(path):
    host = Host(path)
    host.wait_for_commits(1200)
    host.kill("host", "recorder")
    rows = committed(host.part)
    with h5py.File(host.part, "r", swmr=True) as file:
        z = file["online/z_sim"]
        chunks = (z.id.get_chunk_info(each) for each in range(z.id.get_num_chunks()))
        last = max(chunks, key=lambda c: c.chunk_offset)
        torn = last.byte_offset + 8 * (rows - last.chunk_offset[0])
    with host.part.open("r+b") as file:
        file.seek(torn)
        file.write(b"torn off")  # a row that was never committed, or the checksum
    with h5py.File(host.part, "r", swmr=True) as file, pytest.raises(OSError):
        file["online/z_sim"][()]
    await_outcome(lambda: repaired(host.part))
    run = read_run(path)
    assert run.online.time.size == rows
    assert wrong_rows(run) == 0


# As the recorder starts, on a disk that fails where it is synced.
BAD_DISK = """
import errno
from drftjax.runlog.hdf5.recording import Recording
def fail(recording):
    raise OSError(errno.EIO, "Input/output error")
Recording.sync = fail
"""


def test_a_disk_that_fails_behind_the_recorder_stops_the_recording(path, monkeypatch):
    start = recorder_module._START.replace("from hils", f"exec({BAD_DISK!r}); from hils")
    monkeypatch.setattr(recorder_module, "_START", start)
    recorder = Recorder(path, example_head())
    fill(recorder)
    said = "stopped: the disk did not take what was written: Input/output error"
    assert recorder.reason == said
    with pytest.raises(InputError, match=f"{said}; the rows until then are in {path}"):
        recorder.close("stopped")
    assert wrong_rows(read_run(path)) == 0


# Folders -----------------------------------------------------------------------------------------


def test_a_folder_that_is_moved_takes_the_whole_run_log_with_it(tmp_path):
    day, archive = tmp_path / "day", tmp_path / "archive"
    day.mkdir()
    recorder = recorded(day / "run.h5", 50)
    await_outcome(lambda: committed(day / "run.h5.part") == 50)
    day.rename(archive)
    for number in range(50, 80):
        hand_over(recorder, number)
    said = (
        f"{day}/run.h5: the recorder could not finish: {day}/run.h5.part was moved while it was "
        f"recorded; the run log is {archive}/run.h5"
    )
    with pytest.raises(InputError, match=f"^{said}$"):
        recorder.close("completed")
    run = read_run(archive / "run.h5")
    assert run.online.time.size == 80
    assert run.end_reason == "completed"
    assert wrong_rows(run) == 0
    assert [each.name for each in archive.iterdir()] == ["run.h5"]


def test_a_recording_moved_to_where_its_name_is_taken_is_kept_there(tmp_path):
    day, archive = tmp_path / "day", tmp_path / "archive"
    day.mkdir()
    recorder = recorded(day / "run.h5", 50)
    await_outcome(lambda: committed(day / "run.h5.part") == 50)
    day.rename(archive)
    (archive / "run.h5").write_bytes(b"another run")
    said = (
        f"archive/run.h5 .*its rows are kept: drft log repair {archive}/run.h5.part -o ANOTHER.h5$"
    )
    with pytest.raises(InputError, match=said):
        recorder.close("completed")
    assert (archive / "run.h5").read_bytes() == b"another run"
    _, run = repair(archive / "run.h5.part", tmp_path / "kept.h5")
    assert run.online.time.size == 50


def test_a_folder_that_is_removed_stops_the_recording_and_nothing_is_said_to_be_left(tmp_path):
    day = tmp_path / "day"
    day.mkdir()
    recorder = recorded(day / "run.h5", 50)
    await_outcome(lambda: committed(day / "run.h5.part") == 50)
    shutil.rmtree(day)
    fill(recorder)
    said = f"stopped: {day}/run.h5.part was removed while it was recorded; nothing is left of it"
    assert recorder.reason == said
    with pytest.raises(InputError, match=f"^{day}/run.h5: the recorder {said}$"):
        recorder.close("stopped")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mishap", ["moved", "removed"])
def test_a_folder_that_goes_before_the_first_row_is_told(tmp_path, mishap):
    day = tmp_path / "day"
    day.mkdir()
    recorder = Recorder(day / "run.h5")
    if mishap == "moved":
        day.rename(tmp_path / "archive")
    else:
        shutil.rmtree(day)
    recorder.begin(example_head())
    fill(recorder)
    with pytest.raises(InputError, match=r"was moved or removed before the first row$"):
        recorder.close("stopped")
    assert list(tmp_path.rglob("*.h5*")) == []


# Before anything moves ----------------------------------------------------------------------------


def test_a_recorder_that_was_killed_at_a_question_is_refused_before_anything_moves(path):
    recorder = Recorder(path)
    recorder.require_room(example_head())
    os.kill(recorder.pid, signal.SIGKILL)
    recorder._process.wait(DEADLINE)
    with pytest.raises(InputError, match=r"the recorder was ended by SIGKILL$"):
        recorder.require_room(example_head())


def test_a_folder_that_went_at_a_question_is_refused_before_anything_moves(tmp_path):
    day = tmp_path / "day"
    day.mkdir()
    recorder = Recorder(day / "run.h5")
    shutil.rmtree(day)
    with pytest.raises(InputError, match=r"was moved or removed before the first row$"):
        recorder.require_room(example_head())
    recorder.close("not begun")


def test_a_disk_that_filled_at_a_question_is_refused_before_anything_moves(small_disk):
    recorder = Recorder(small_disk / "run.h5")
    (small_disk / "ballast").write_bytes(bytes(5 * 2**20))
    with pytest.raises(InputError, match=r"run\.h5: the disk is full"):
        recorder.require_room(example_head())
    recorder.close("not begun")


# Repair ------------------------------------------------------------------------------------------


def test_a_repaired_run_says_so_and_goes_where_it_is_told(path):
    host = Host(path)
    host.wait_for_commits(10)
    host.kill("host", "recorder")
    await_outcome(lambda: repaired(host.part))
    run = read_run(path)
    assert run.end_reason == CUT_OFF
    assert run.online.loop == example_head().online.loop
    with h5py.File(path) as file:
        assert "complete" not in file.attrs
        assert "n_committed" not in file
    assert host.part.exists()
    with pytest.raises(InputError, match="--force"):
        repair(host.part)
    other = path.with_name("other.h5")
    assert repair(host.part, other)[0] == other
    assert wrong_rows(read_run(other)) == 0
    moved = host.part.rename(path.with_name("moved"))
    with pytest.raises(InputError, match="name the output too"):
        repair(moved)
    repair(moved, path, force=True)


def test_a_file_that_is_no_recording_is_not_repaired(path):
    recorded(path, 3).close("completed")
    part = part_path(path.with_name("other.h5"))
    shutil.copy(path, part)
    with pytest.raises(InputError, match="is no recording"):
        repair(part)
    part.write_bytes(b"plain text")
    with pytest.raises(InputError, match=f"{part}: is not an HDF5 file"):
        repair(part)
    part.unlink()
    with pytest.raises(InputError, match=r"no such file$"):
        repair(part)
    with pytest.raises(InputError, match=f"{path} is there, which needs no repair$"):
        repair(part_path(path))
    with pytest.raises(InputError, match=r"cut off ends in \.h5\.part"):
        repair(path)


# Disks -------------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(folder)],
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip("only root can mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(recorder: Recorder) -> int:
    """Hand rows over until the recorder is lost; how many."""
    number, deadline = 0, time.monotonic() + DEADLINE
    while recorder.alive:
        for each in range(number, number + 50):
            hand_over(recorder, each)
        number += 50
        time.sleep(0.005)
        assert time.monotonic() < deadline
    return number


def test_a_full_disk_stops_the_recording_before_hdf5_meets_it(small_disk):
    path = small_disk / "run.h5"
    recorder = Recorder(path, example_head())
    handed = fill(recorder)
    assert recorder.reason.startswith("stopped: the disk is full: ")
    with pytest.raises(
        InputError, match=f"the disk is full: .*; the rows until then are in {path}"
    ):
        recorder.close("stopped")
    run = read_run(path)
    assert 1000 < run.online.time.size <= handed
    assert wrong_rows(run) == 0
    assert run.end_reason.startswith("stopped: the disk is full")
    assert list(small_disk.iterdir()) == [path]


def test_the_reason_is_told_though_nobody_waited_for_the_recorder_to_begin(small_disk):
    recorder = Recorder(small_disk / "run.h5")
    recorder.begin(example_head())
    fill(recorder)
    assert recorder.reason.startswith("stopped: the disk is full: ")
    with pytest.raises(InputError, match="the disk is full"):
        recorder.close("stopped")


def test_a_disk_that_is_full_from_the_start_is_refused(small_disk):
    (small_disk / "ballast").write_bytes(bytes(5 * 2**20))
    for head in (None, example_head()):
        with pytest.raises(InputError, match="the disk is full"):
            Recorder(small_disk / "run.h5", head)
    assert [each.name for each in small_disk.iterdir()] == ["ballast"]


def test_a_limit_on_the_size_of_files_stops_the_recording_before_hdf5_meets_it(path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4 * 2**20, hard))
    try:
        recorder = Recorder(path, example_head())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    fill(recorder)
    with pytest.raises(InputError, match=r"may not grow past 4\.0 MiB"):
        recorder.close("stopped")
    run = read_run(path)
    assert run.online.time.size > 1000
    assert wrong_rows(run) == 0
