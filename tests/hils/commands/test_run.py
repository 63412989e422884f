"""`drft hils run` and `drft hils stop` against a virtual rig in processes of their own.

What is looked at are outcomes: how the program ends, its file, and what the rig says of itself.
The control period is long: a busy machine lets processes wait, which is no case for a watchdog.
Signals, faults and ends of every other kind are `tests/hils/control/test_loop.py`'s and
`tests/hils/procedure/test_start.py`'s, in virtual time.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.runlog.hdf5.api import read_run, survey_run
from drftjax.runlog.record import RunLog
from hils.procedure.active_runs import ActiveRun, is_alive, registered, runs_under_way
from hils.procedure.stop_runs import stop_runs
from tests.helpers.recording_host import committed

DRFT = [sys.executable, "-m", "drftjax.commands.main"]
TICK = 0.1
PATIENCE = 180.0  # four processes may share half a core [s]
TRIES = 3
TOO_BUSY = (
    "does not answer|went SAFE|has sent no measurement|the recorder did not answer"
    "|this computer sent no command for"
)
# HILS (sim) and HILS (real), at ten ticks a second and with coarse plates [m].
CLOSE = 1.5e-3
# What the rig's zeta asks for of a wheel at rest, and what coarse plates may add [m].
STANDS, COARSE = 0.017, 0.001
# Up in a second, half a second at 30 deg/s and down in one: but for slip, and for ticks of a tenth
# of a second that a busy machine skips, a few of the thirty [m].
WAY, LATE = 0.150 * 0.5236 * 1.5, 0.4

PROFILE = """
title = "a short profile"
[wheel]
plate_size = 0.008
[command]
time = [0, 0.5, 1.5, 2.0, 3.0]
omega = [0, 0, 30, 30, 0]
omega_unit = "deg/s"
[integrator]
step = 2e-3
"""

BACKWARD = PROFILE.replace("30, 30", "-30, -30")

RIG = """
[physics]
step = 1e-3
plate_size = 0.008
"""


class Bench:
    """A virtual rig that is switched on, and runs on it, each in a folder of its own."""

    def __init__(self, folder: Path):
        self.port, self._rig_says = folder / "port", folder / "rig.txt"
        (folder / "rig.toml").write_text(RIG)
        self.rig = subprocess.Popen(
            [*DRFT, "hils", "rig", "--setup", folder / "rig.toml", "--link", self.port],
            stdout=subprocess.PIPE,
            stderr=self._rig_says.open("w"),
            text=True,
        )
        assert self.rig.stdout is not None
        assert self.rig.stdout.readline()
        self._seen = 0

    def run(self, folder: Path, *arguments: object, profile: str = PROFILE) -> subprocess.Popen:
        """Start a run; what it says is in run.txt."""
        self.folder, self._seen = folder, len(self._rig_says.read_text())
        (folder / "profile.toml").write_text(profile)
        return subprocess.Popen(
            [
                *(*DRFT, "hils", "run", "--port", self.port, "--no-ui", "--yes", "--no-plot"),
                *("--profile", folder / "profile.toml", "-o", folder / "run.h5"),
                *("--tick", str(TICK), "--countdown", "0.3", *map(str, arguments)),
            ],
            stdout=(folder / "run.txt").open("w"),
            stderr=subprocess.STDOUT,
        )

    def running(self, folder: Path, *arguments: object, **options: str) -> subprocess.Popen:
        """A run whose wheel turns.

        A machine that is so busy that a process waits for half a second gets another try: the
        host takes such a rig for a dead one, and the rig such a host, and both are right.
        """
        for _ in range(TRIES):
            run = self.run(folder, *arguments, **options)
            while run.poll() is None:
                if "RUNNING" in self.rig_said():
                    time.sleep(0.5)  # so that something is recorded
                    return run
                time.sleep(0.02)
            assert re.search(TOO_BUSY, self.said()), self.said()
        raise AssertionError(self.said())

    def said(self) -> str:
        return (self.folder / "run.txt").read_text()

    def rig_says(self, state: str) -> None:
        """Wait until the rig has said that it is in this state, since the run was started."""
        deadline = time.monotonic() + PATIENCE
        while state not in self.rig_said():
            assert time.monotonic() < deadline, f"{self.rig_said()}\n{self.said()}"
            time.sleep(0.05)

    def rig_said(self) -> str:
        """What the rig said since the last run was started."""
        return self._rig_says.read_text()[self._seen :]

    def ends(self, run: subprocess.Popen) -> int:
        return run.wait(PATIENCE)

    def log(self) -> RunLog:
        return read_run(self.folder / "run.h5")


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Iterator[Bench]:
    made = Bench(tmp_path_factory.mktemp("bench"))
    yield made
    made.rig.kill()
    made.rig.wait()


def require_backward(log: RunLog) -> None:
    """The wheel turned backward, and sank as one that turns forward does, to 29 mm."""
    assert log.end_reason == "completed"
    assert log.measured.x[-1] == pytest.approx(-WAY, rel=LATE)
    assert 0.01 < -log.measured.z.min() < 0.03
    assert min(log.command.omega) == pytest.approx(-np.deg2rad(30))


def test_run_is_completed_recorded_and_reported(bench, tmp_path):
    run = bench.running(tmp_path, "--tuner", "kalman", profile=BACKWARD)
    assert bench.ends(run) == 0, bench.said()
    assert "Completed." in bench.said()
    log = bench.log()
    require_backward(log)
    assert log.source == "virtual rig"
    assert log.title == "a short profile"
    assert log.online is not None
    assert log.online.tick == TICK
    assert len(log.online.time) >= 25
    assert abs(log.measured.z[-1] - log.online.z_sim[-1]) < CLOSE
    assert log.setup.sinkage_static == pytest.approx(STANDS, abs=COARSE)
    bench.rig_says("IDLE (bye")
    assert survey_run(tmp_path / "run.h5")[1] == []


def test_free_wheel_turns_backward(bench, tmp_path):
    run = bench.running(tmp_path, "--mode", "free", profile=BACKWARD)
    assert bench.ends(run) == 0, bench.said()
    require_backward(bench.log())


def test_ctrl_c_ramps_down_and_closes_the_file(bench, tmp_path):
    run = bench.running(tmp_path)
    run.send_signal(signal.SIGINT)
    assert bench.ends(run) == 130, bench.said()
    assert bench.log().end_reason == "interrupted by Ctrl-C"
    assert "Ended early: interrupted by Ctrl-C." in bench.said()
    bench.rig_says("IDLE (bye")


@pytest.mark.parametrize(
    ("option", "reason", "state"),
    [
        ([], "stopped by the operator", "IDLE (bye"),
        (["--now"], "emergency stop: asked for by the operator", "SAFE"),
    ],
)
def test_stop_from_another_terminal(bench, drft, tmp_path, option, reason, state):
    run = bench.running(tmp_path)
    stopped = drft("hils", "stop", "--port", bench.port, *option)
    assert stopped.code == 0, stopped
    assert "has ended; its file is" in stopped.out
    assert bench.ends(run) == 1, bench.said()
    assert bench.log().end_reason == reason
    bench.rig_says(state)


def recorder_of(run: subprocess.Popen) -> int:
    """The process that records it."""
    lists = Path(f"/proc/{run.pid}/task").glob("*/children")
    children = [int(each) for text in lists for each in text.read_text().split()]
    (found,) = (
        each for each in children if b"recorder" in Path(f"/proc/{each}/cmdline").read_bytes()
    )
    return found


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the recorder is found by /proc")
def test_recorder_that_hangs_brings_the_rig_to_rest(bench, tmp_path):
    run = bench.running(tmp_path, profile=PROFILE.replace("2.0, 3.0]", "99.0, 100.0]"))
    recorder = recorder_of(run)
    os.kill(recorder, signal.SIGSTOP)
    try:
        bench.rig_says("IDLE (bye")
        assert run.poll() is None  # it waits for the file
        kept = committed(tmp_path / "run.h5.part")
    finally:
        os.kill(recorder, signal.SIGCONT)
    assert bench.ends(run) == 2, bench.said()
    assert "Ended early: the recorder took no rows for 4 s." in bench.said()
    assert "took no rows for 4 s; the rows until then are in" in bench.said()
    log = bench.log()
    assert log.end_reason == "the recorder took no rows for 4 s"
    assert log.online.time.size > kept > 0
    assert log.command.time[-1] < 50.0
    assert log.command.omega[-1] == 0.0
    assert np.abs(np.diff(log.command.omega)).max() < (1 + 1e-9) * TICK  # 1 rad/s2, and rounding


def test_killed_rig_ends_the_run_with_its_file_closed(bench, tmp_path):
    run = bench.running(tmp_path)
    bench.rig.kill()
    assert bench.ends(run) == 1, bench.said()
    assert bench.log().end_reason.startswith("link lost: ")
    assert "its own watchdog brings it to rest" in bench.said()


# Nothing is opened -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--tick", "0.0001"], "tick is 0.0001, must lie between"),
        (["--tick", "0.001", "--baud", "115200"], "is too short for 115200 baud"),
        (["--tick", "0"], "tick is 0, must lie between 0.0005 and 0.1 s"),
        (["--tick", "0", "--mode", "free"], "tick is 0, must lie between 0.0005 and 0.1 s"),
        (["--mode", "free", "--tuner", "kalman"], "--tuner would be ignored: in --mode free"),
        (
            ["--mode", "free", "--zeta-step", "0.1", "--tuning-ticks", "2"],
            "--zeta-step, --tuning-ticks would be ignored",
        ),
        (["--tuner", "pi", "--zeta-step", "0.1"], "the tuner 'pi' has no number 'zeta_step'"),
        (["--between", "true"], "--between would be ignored: one run has none after it"),
        (["--port", ""], "--port is empty, must be a device"),
        (["--number", "noise"], "--number is 'noise', must be NAME=VALUE"),
        (["--zeta-step", "0.1", "--number", "zeta-step=0.2"], "'zeta_step' is given twice"),
        (["--port", "rfc2217://h:1", "--baud", "115200", "--tick", "0.001"], "is too short for"),
        (["--omega-max", "nan"], "omega-max is nan, must lie between"),
        (["--vx-max", "nan"], "vx-max is nan, must lie between"),
        (["--zeta0", "nan"], "zeta0 is nan, must lie between 0.05 and 20"),
        (["--zeta0", "0"], "zeta0 is 0, must lie between 0.05 and 20"),
        (["--omega-max", "0.1"], "the loop allows 0.1 rad/s at most"),
        (["--stream", "udp:/x"], "--stream is 'udp:/x', must be udp://HOST:PORT or foxglove://"),
        (["--stream", "udp://127.0.0.1:70000"], "the port from 1 to 65535"),
        (["-o", "run.csv"], "a run log's name must end in .h5"),
        (["-o", "run.csv", "--repeat", "3"], "run.csv: a run log's name must end in .h5"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_opened(drft, tmp_path, arguments, said):
    (tmp_path / "profile.toml").write_text(PROFILE)
    port, profile = tmp_path / "nothing", tmp_path / "profile.toml"
    fixed = ["--port", port, "--profile", profile, "-o", tmp_path / "run.h5", "--yes"]
    answer = drft("hils", "run", *fixed, *arguments)
    assert said in answer.refusal
    assert sorted(each.name for each in tmp_path.iterdir()) == ["profile.toml"]


def test_port_that_is_not_there_is_one_sentence_and_leaves_no_file(drft, tmp_path):
    (tmp_path / "profile.toml").write_text(PROFILE)
    fixed = ["--port", tmp_path / "nothing", "--profile", tmp_path / "profile.toml"]
    answer = drft("hils", "run", *fixed, "-o", tmp_path / "run.h5", "--yes", "--no-ui")
    assert str(tmp_path / "nothing") in answer.refusal
    assert sorted(each.name for each in tmp_path.iterdir()) == ["profile.toml"]


def test_run_log_that_is_already_there_is_not_written_over(drft, tmp_path):
    (tmp_path / "profile.toml").write_text(PROFILE)
    (tmp_path / "run-02.h5").write_text("precious")
    fixed = ["--port", tmp_path / "nothing", "--profile", tmp_path / "profile.toml"]
    answer = drft("hils", "run", *fixed, "-o", tmp_path / "run.h5", "--yes", "--repeat", "3")
    assert "run-02.h5 is already there" in answer.refusal


# Who is under way ------------------------------------------------------------------------------


@pytest.fixture
def base(monkeypatch, tmp_path) -> Path:
    """Where nobody else announces runs."""
    monkeypatch.setattr("hils.procedure.active_runs.REGISTRY_PARENT", tmp_path)
    return tmp_path


def test_stop_without_a_run_says_so(drft, base):
    assert "no run of this user's is under way" in drft("hils", "stop").refusal


def test_stop_names_no_file_where_none_was_made(drft, base, monkeypatch):
    monkeypatch.setattr("hils.procedure.active_runs.send_signal", lambda run, kind: None)
    monkeypatch.setattr("hils.procedure.active_runs.wait_until_ended", lambda run, within: True)
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        assert drft("hils", "stop").out == "the run on /dev/ttyUSB0 has ended\n"
        (base / "run.h5").touch()
        assert f"has ended; its file is {base / 'run.h5'}" in drft("hils", "stop").out


def test_stop_speaks_of_the_emergency_stop_while_the_file_is_closed_and_waits_on(
    base, monkeypatch, capsys
):
    monkeypatch.setattr("hils.procedure.active_runs.send_signal", lambda run, kind: None)
    with registered("/dev/ttyUSB0", [base / "run.h5"]), pytest.raises(InputError) as refused:
        stop_runs(None, now=False, longest_close=0.3, longest_ramp=0.1)
    first, second = capsys.readouterr().err, str(refused.value)
    assert "has not ended in 0.1 s; its file may be being closed. Where the rig" in first
    assert second.startswith("the run on /dev/ttyUSB0 ")
    assert "has not ended in 0.4 s; use the rig's emergency stop" in second


def test_runs_are_found_while_they_last_and_not_after(monkeypatch, base):
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/of/this/terminal")
    monkeypatch.setenv("TMPDIR", "/of/this/terminal")
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        monkeypatch.setenv("XDG_RUNTIME_DIR", "/of/another")
        monkeypatch.delenv("TMPDIR")
        (found,) = runs_under_way()
        assert found.port == "/dev/ttyUSB0"
        assert is_alive(found)
        # Another process that was given the same number is not that run.
        assert not is_alive(ActiveRun(found.pid, "1", found.port, found.output))
    assert runs_under_way() == []


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_folder_that_others_may_write_to_names_no_runs(base, mode):
    folder = base / f"drft-hils-{os.getuid()}"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(InputError, match="only its owner"):
        runs_under_way()


def test_what_a_killed_run_left_is_removed(base):
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        (entry,) = base.glob("drft-hils-*/*.json")
        entry.write_text(entry.read_text().replace('"born":"', '"born":"9'))
        assert runs_under_way() == []
        assert not entry.exists()
