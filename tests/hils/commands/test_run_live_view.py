"""`drft hils run` at a pseudo-terminal, with its questions, its live view and its picture.

What is looked at are outcomes. The control period is long, so that a busy machine, which lets
processes wait, is no watchdog's case.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drftjax.runlog.hdf5.api import read_run
from tests.helpers.pseudo_terminal import PseudoTerminal, soon

DRFT = [sys.executable, "-m", "drftjax.commands.main"]

PROFILE = """
[wheel]
plate_size = 0.008
[command]
time = [0, 0.5, 1.5, 2.5, 3.5]
omega = [0, 0, 30, 30, 0]
omega_unit = "deg/s"
[integrator]
step = 2e-3
"""
# For the tests that end the run themselves.
LONG = PROFILE.replace("2.5, 3.5", "60, 61")

RIG = """
[physics]
step = 1e-3
plate_size = 0.008
"""


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    port = tmp_path / "port"
    process = subprocess.Popen(
        [*DRFT, "hils", "rig", "--setup", tmp_path / "rig.toml", "--link", port],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdout is not None
    assert process.stdout.readline()
    yield port
    process.kill()
    process.wait()


@pytest.fixture
def start(rig, tmp_path):
    terminals = []

    def run(profile: str, *arguments: str) -> PseudoTerminal:
        (tmp_path / "profile.toml").write_text(profile)
        command = [*DRFT, "hils", "run", "--port", str(rig), "--profile", "profile.toml"]
        timing = ["--tick", "0.1", "--countdown", "0.3", "--no-fifo"]
        terminals.append(PseudoTerminal([*command, "-o", "run.h5", *timing, *arguments], tmp_path))
        return terminals[-1]

    yield run
    for terminal in terminals:
        terminal.close()


def children(process: int) -> list[int]:
    """What this process has started, and what those have."""
    found = []
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = each.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            found += [int(each.parent.name), *children(int(each.parent.name))]
    return found


def view_of(terminal: PseudoTerminal) -> int:
    def is_view(process: int) -> bool:
        return b"hils.monitor.view_process" in Path(f"/proc/{process}/cmdline").read_bytes()

    return next(each for each in children(terminal.leader) if is_view(each))


def test_questions_then_view_then_stop_key(start, tmp_path):
    terminal = start(LONG)
    terminal.sees("Hold the wheel.*press Enter")
    terminal.type("\n")
    terminal.sees("Let the wheel down.*press Enter")
    terminal.type("\n")
    terminal.sees("RUNNING")
    terminal.sees(r"H_sim \S*1\d\.\d\d mm")
    terminal.type("s")
    assert terminal.ends() == 1
    assert terminal.mode() == terminal.before
    # What was said while the view was there is on the ordinary screen.
    after = terminal.text.rpartition("\x1b[?1049l")[2]
    assert "At rest" in after
    assert "Ended early: stopped by the operator" in after
    assert read_run(tmp_path / "run.h5").end_reason == "stopped by the operator"
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    assert "Ended early: stopped by the operator" in (tmp_path / "run.html").read_text()


def test_run_whose_view_was_killed_is_completed(start, tmp_path):
    terminal = start(PROFILE, "--yes")
    terminal.sees("SETTLING|COUNTDOWN|RUNNING")
    os.kill(view_of(terminal), signal.SIGKILL)
    assert soon(lambda: terminal.mode() == terminal.before)
    assert terminal.ends() == 0
    assert "Completed" in terminal.text
    assert read_run(tmp_path / "run.h5").end_reason == "completed"


def test_no_ui_leaves_the_screen_alone(start):
    terminal = start(LONG, "--yes", "--no-ui", "--no-plot")
    terminal.sees("At rest")
    assert terminal.mode() == terminal.before
    terminal.type("\x03")
    assert terminal.ends() == 130
    assert "\x1b" not in terminal.text
    assert "Picture" not in terminal.text
