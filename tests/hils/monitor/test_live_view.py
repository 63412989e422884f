"""The live view as a process at a pseudo-terminal: the stop key, and whoever is killed.

Deadlines are on outcomes and generous: the machine may be busy.
"""

import os
import signal
import sys

import pytest

from tests.helpers.pseudo_terminal import PseudoTerminal, soon

# To the other screen and back, as a terminal understands it.
ENTERED, LEFT = "\x1b[?1049h", "\x1b[?1049l"

# A control program that shows scenes until it is asked to stop; what it says goes to a file.
HOST = """
import os, sys, time
from pathlib import Path
from hils.monitor.live_view import LiveView
from hils.events import Phase
from hils.monitor.status import RunStatus
from hils.control.stop_request import StopRequest
from hils.procedure.active_runs import registered

said = open("said", "w", buffering=1)
stop = StopRequest()
stop.uninterruptible = True
with registered("/dev/rig", [Path("run.h5")]) as run, stop.on_signals():
    view = LiveView(run)
    print("host", os.getpid(), file=said)
    print("view", view.pid, file=said)
    number = 0
    while stop.first_reason is None:
        number += 1
        view.show(RunStatus(phase=Phase.RUNNING, time=number * 0.05, duration=24.0, real=0.0123))
        if number % 20 == 0:
            print("shown", number, file=said)
        time.sleep(PAUSE)
    time.sleep(0.5)
    began = time.monotonic()
    view.close()
    print("closed", time.monotonic() - began, file=said)
print("ended", stop.emergency, stop.first_reason.reason, file=said)
"""


class Host:
    """The control program at its terminal."""

    def __init__(self, folder, pause=0.05):
        self._said = folder / "said"
        program = HOST.replace("PAUSE", str(pause))
        self.terminal = PseudoTerminal([sys.executable, "-c", program], folder)

    def said(self, word: str) -> str:
        """What it said last after this word, waiting for it."""
        found: list[str] = []

        def there() -> bool:
            lines = self._said.read_text().splitlines() if self._said.exists() else []
            found.extend(
                line.removeprefix(f"{word} ") for line in lines if line.startswith(f"{word} ")
            )
            return bool(found)

        assert soon(there), f"never said {word}"
        return found[-1]

    def kill(self, who: str, kind: signal.Signals = signal.SIGKILL) -> None:
        os.kill(int(self.said(who)), kind)

    def shown(self) -> int:
        return int(self.said("shown"))


@pytest.fixture
def started(tmp_path):
    hosts: list[Host] = []

    def start(**options) -> Host:
        hosts.append(Host(tmp_path, **options))
        return hosts[-1]

    yield start
    for host in hosts:
        host.terminal.close()


def given_back(terminal: PseudoTerminal) -> bool:
    return terminal.mode() == terminal.before and LEFT in terminal.text


def test_view_shows_the_run_and_gives_the_terminal_back(started):
    host = started()
    host.terminal.sees("H_real.*12.30 mm")
    host.terminal.sees("press S or SPACE")
    assert host.terminal.mode() != host.terminal.before
    host.kill("host", signal.SIGTERM)
    assert host.terminal.ends() == 0
    assert given_back(host.terminal)
    assert host.terminal.text.count(ENTERED) == host.terminal.text.count(LEFT) == 1


def test_held_stop_key_asks_for_one_ramp_down(started):
    host = started()
    host.terminal.sees("H_real")
    host.terminal.type("sssss")
    assert host.said("ended") == "False stopped by the operator"
    assert host.terminal.ends() == 0
    assert given_back(host.terminal)


def test_emergency_key_but_no_function_key_that_holds_its_letter(started):
    host = started()
    host.terminal.sees("H_real")
    host.terminal.type("\x1b[E\x1bOS")
    shown = host.shown()
    assert soon(lambda: host.shown() > shown + 20)
    host.terminal.type("e")
    assert host.said("ended").startswith("True")
    assert host.terminal.ends() == 0


def test_ctrl_c_stays_the_control_programs_and_ctrl_z_suspends_nothing(started):
    host = started()
    host.terminal.sees("H_real")
    host.terminal.type("\x13\x1a")  # Ctrl-S, Ctrl-Z
    shown = host.shown()
    assert soon(lambda: host.shown() > shown + 40)
    host.terminal.type("\x03")
    assert host.said("ended") == "False interrupted by Ctrl-C"
    assert host.terminal.ends() == 0
    assert given_back(host.terminal)


def test_ctrl_backslash_stays_an_emergency_stop(started):
    host = started()
    host.terminal.sees("H_real")
    host.terminal.type("\x1c")
    assert host.said("ended").startswith("True")
    assert host.terminal.ends() == 0
    assert given_back(host.terminal)


def test_run_outlives_its_view_and_has_its_terminal_back_at_once(started):
    host = started()
    host.terminal.sees("H_real")
    host.kill("view")
    assert soon(lambda: given_back(host.terminal))
    shown = host.shown()
    assert soon(lambda: host.shown() > shown + 20)
    host.terminal.type("\x03")
    assert host.said("ended").startswith("False")
    assert host.terminal.ends() == 0


def test_view_gives_the_terminal_back_after_kill_9_of_the_control_program(started):
    host = started()
    host.terminal.sees("H_real")
    host.kill("host")
    assert host.terminal.ends() == -signal.SIGKILL
    assert soon(lambda: given_back(host.terminal))
    view = int(host.said("view"))
    assert soon(lambda: not alive(view))


def test_stuck_view_holds_nothing_up(started):
    host = started(pause=0.0)
    host.terminal.sees("H_real")
    host.kill("view", signal.SIGSTOP)
    shown = host.shown()
    # Far more than the pipe holds.
    assert soon(lambda: host.shown() > shown + 5000)
    host.kill("host", signal.SIGTERM)
    host.said("closed")
    assert host.terminal.ends() == 0
    assert given_back(host.terminal)


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{process}/stat") as file:  # noqa: PTH123
        return file.read().rpartition(")")[2].split()[0] != "Z"
