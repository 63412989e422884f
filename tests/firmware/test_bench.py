"""The reference firmware at a pseudo-terminal, with this project's host at the other end."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drftjax.runlog.hdf5.api import read_run
from hils.conformance.catalogue import HELLO_RULES
from hils.conformance.probe import Probe
from hils.conformance.rule import Rule, finding
from tests.helpers.c_firmware import FIRMWARE, compile_c
from tests.helpers.drft_command import Drft

PATIENCE = 30.0  # for anything to happen at all on a busy machine [s]
TICK = 0.05  # its watchdog of 250 ms outlasts most pauses of a busy machine
# A machine that stops for longer ends the run by the rig's watchdog, and the host says so: the run
# is then made again.
HOST_PAUSED, TRIALS = "this computer sent no command for", 3
# The bench stands 16.5 mm deep, its scale in steps of 10 um; settling ends within 0.1 mm of rest.
STANDS, DEPTH = 0.0165, 2e-4
# Up in a second, half a second at 30 deg/s and down in one: but for slip, and for ticks that a busy
# machine skips, the way of the rim [m].
WAY, LATE = 0.150 * 0.5236 * 1.5, 0.3
PROFILE = """
[wheel]
plate_size = 0.008
[command]
time = [0, 0.5, 1.5, 2.0, 3.0]
omega = [0, 0, 30, 30, 0]
omega_unit = "deg/s"
[integrator]
step = 2e-3
"""


def turn_on_a_busy_machine(probe: Probe) -> None:
    """Let the wheel turn with the longest watchdog, 500 ms.

    In a pause that outlasts it the rig comes to rest by itself, and the rule is not judged.
    """
    probe.make_turn(probe.settings.long_tick_us)


class BenchProcess:
    """Running reference firmware, with what it says of its state."""

    def __init__(self, program: Path, folder: Path):
        self.port, self._said = folder / "port", folder / "rig.txt"
        self.process = subprocess.Popen(
            [program, self.port], stdout=subprocess.PIPE, stderr=self._said.open("w")
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline()

    def states(self) -> list[str]:
        return self._said.read_text().splitlines()

    def reaches(self, state: str) -> bool:
        """Wait for a state to be the last that is told."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if self.states()[-1:] == [state]:
                return True
            time.sleep(0.01)
        return False


@contextlib.contextmanager
def started(program: Path, folder: Path) -> Iterator[BenchProcess]:
    running = BenchProcess(program, folder)
    try:
        yield running
    finally:
        running.process.kill()
        running.process.wait()


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("firmware") / "rig"
    return compile_c(output, "-std=c99", "-O2", *FIRMWARE.glob("*.c"))


@pytest.fixture
def bench(program: Path, tmp_path: Path) -> Iterator[BenchProcess]:
    with started(program, tmp_path) as running:
        yield running


@pytest.fixture
def drft(monkeypatch, capsys) -> Drft:
    return Drft(monkeypatch, capsys)


def run_in_the_loop(port: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "profile.toml").write_text(PROFILE)
    return subprocess.run(
        [
            *(sys.executable, "-m", "drftjax.commands.main", "hils", "run", "--port", port),
            *("--profile", "profile.toml", "-o", "run.h5", "--no-ui", "--no-plot", "--yes"),
            *("--tick", str(TICK), "--countdown", "0.3"),
        ],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_run_in_the_loop_is_completed(program, tmp_path):
    for trial in range(TRIALS):
        folder = tmp_path / str(trial)
        folder.mkdir()
        with started(program, folder) as bench:
            run = run_in_the_loop(bench.port, folder)
            if HOST_PAUSED in run.stdout and trial < TRIALS - 1:
                continue
            assert run.returncode == 0, run.stdout + run.stderr
            assert "Completed." in run.stdout
            completed_as_commanded(folder, bench)
            return


def completed_as_commanded(folder: Path, bench: BenchProcess) -> None:
    log = read_run(folder / "run.h5")
    assert log.measured is not None
    height, travel = np.asarray(log.measured.z), np.asarray(log.measured.x)
    assert height[0] == pytest.approx(-STANDS, abs=DEPTH)
    assert height[-1] < height[0] - DEPTH  # it sinks as it turns
    assert travel[-1] == pytest.approx(WAY, rel=LATE)
    assert bench.states() == [
        *("state 0, reason 0", "state 1, reason 0", "state 2, reason 0"),
        *("state 1, reason 4", "state 0, reason 8"),
    ]


def test_a_rig_that_keeps_the_rules_ends_with_0(bench, drft, monkeypatch):
    monkeypatch.setattr("hils.conformance.catalogue.rules", lambda moving: HELLO_RULES[:3])
    answer = drft("hils", "conform", "--port", bench.port)
    assert answer.code == 0
    assert answer.out.count("pass") == 3
    assert "3 rules: 3 kept, 0 broken, 0 not judged." in answer.out


def test_a_broken_rule_ends_with_1(bench, drft, monkeypatch):
    rule = Rule("a rule", "The wire's sentence.", lambda probe: finding(False, "it breaks it"))
    monkeypatch.setattr("hils.conformance.catalogue.rules", lambda moving: (rule,))
    answer = drft("hils", "conform", "--port", bench.port)
    assert answer.code == 1
    assert '"The wire\'s sentence."' in answer.out
    assert "1 broken (a rule)" in answer.out


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_trial_leaves_the_wheel_at_rest(bench, drft, monkeypatch, order):
    def interrupts(probe):
        turn_on_a_busy_machine(probe)
        assert bench.reaches("state 2, reason 0")
        os.kill(os.getpid(), order)
        probe.stream(probe.turn(), 5.0)

    rule = Rule("a turn", "CMD", interrupts, moving=True)
    monkeypatch.setattr("hils.conformance.catalogue.rules", lambda moving: (rule,))
    answer = drft("hils", "conform", "--port", bench.port, "--moving", "--yes")
    assert answer.code == 130, answer
    assert bench.reaches("state 0, reason 8")
    assert bench.states()[-2] == "state 1, reason 4"  # STOP, then BYE


def test_the_rigs_own_button_ends_the_trial(bench, drft, monkeypatch):
    def press(probe):
        turn_on_a_busy_machine(probe)
        bench.process.send_signal(signal.SIGUSR1)
        probe.stream(probe.turn(), PATIENCE)

    rule = Rule("a turn", "CMD", press, moving=True)
    monkeypatch.setattr("hils.conformance.catalogue.rules", lambda moving: (rule,))
    answer = drft("hils", "conform", "--port", bench.port, "--moving", "--yes")
    assert "made an emergency stop, reason 100: release it and start again" in answer.refusal
    assert bench.reaches("state 3, reason 100")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--port", ""], ["--port is empty"]),
        (["--port", "/no/such/port"], ["/no/such/port cannot be opened", "no such port"]),
        (["--port", "rig", "--baud", "300"], ["300 baud", "MEAS of 39 bytes"]),
        (["--port", "rig", "--patience", "nan"], ["patience is nan, must lie between 0 and 60"]),
        (["--port", "rig", "--moving"], ["nobody is at the terminal", "--yes"]),
        (["--port", "loop://"], ["no rig on loop://", "HELLO is not answered"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(drft, monkeypatch, arguments, words):
    monkeypatch.setattr("sys.stdin", open(os.devnull))  # noqa: PTH123, SIM115
    refusal = drft("hils", "conform", *arguments).refusal
    assert all(word in refusal for word in words), refusal
