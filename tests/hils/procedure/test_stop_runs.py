"""`drft hils stop` before anything else: imported modules, options, and exit codes."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
from hils.procedure import active_runs
from hils.procedure.active_runs import registered, runs_under_way
from hils.procedure.stop_runs import stop_from_command_line

# Of this project, up to the signal.
OWN = {"drftjax", "hils", "identify"}

PROGRAM = """
import os, sys
before = set(sys.modules)
from pathlib import Path
from hils.procedure import active_runs
active_runs.REGISTRY_PARENT = Path(sys.argv.pop())
kill = os.kill
def tell(pid, kind):
    if kind:
        new = {each.partition(".")[0] for each in set(sys.modules) - before}
        print(int(kind), *sorted(new - set(sys.stdlib_module_names)))
        raise SystemExit
    kill(pid, kind)
os.kill = tell
from drftjax.commands.entry import main
with active_runs.registered("/dev/ttyUSB0", [Path("run.h5")]):
    main()
"""


@pytest.fixture(autouse=True)
def base(monkeypatch, tmp_path) -> Path:
    monkeypatch.setattr(active_runs, "REGISTRY_PARENT", tmp_path)
    return tmp_path


@pytest.fixture
def sent(monkeypatch) -> list[signal.Signals]:
    found = []
    monkeypatch.setattr(active_runs, "send_signal", lambda run, kind: found.append(kind))
    monkeypatch.setattr(active_runs, "wait_until_ended", lambda run, within: True)
    return found


def test_only_pythons_own_library_is_imported_before_the_signal(base):
    command = [sys.executable, "-c", PROGRAM, "hils", "stop", "--now", str(base)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    kind, *packages = answer.stdout.split()
    assert int(kind) == EMERGENCY_SIGNAL
    assert set(packages) == OWN


def test_each_form_of_the_options_is_followed(base, sent, capsys):
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        assert stop_from_command_line([]) == 0
        assert stop_from_command_line(["--now"]) == 0
        assert stop_from_command_line(["--port", "/dev/ttyUSB0", "--now"]) == 0
        assert stop_from_command_line(["--port=/dev/ttyUSB0"]) == 0
    assert sent == [STOP_SIGNAL, EMERGENCY_SIGNAL, EMERGENCY_SIGNAL, STOP_SIGNAL]
    assert capsys.readouterr().out.count("has ended") == 4


def test_a_run_on_another_port_is_left_alone(base, sent, capsys):
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        assert stop_from_command_line(["--now", "--port", "/dev/ttyUSB1"]) == 2
    assert sent == []
    assert "no run is under way on /dev/ttyUSB1, but on /dev/ttyUSB0" in capsys.readouterr().err


@pytest.mark.parametrize("odd", [["--help"], ["-h"], ["--nwo"], ["--port"], ["now"], ["--now=1"]])
def test_odd_options_stop_nothing_and_go_to_the_command_line(base, sent, odd):
    with registered("/dev/ttyUSB0", [base / "run.h5"]):
        assert stop_from_command_line(odd) is None
    assert sent == []


@pytest.mark.parametrize(
    "entry", ["", "{", "[]", '{"pid": 1}', '{"pid": "x", "born": "", "port": "", "output": ""}']
)
def test_an_entry_that_is_none_is_passed_over(base, entry):
    with registered("/dev/ttyUSB0", [base / "run.h5"]) as run:
        (base / f"drft-hils-{os.getuid()}" / "0.json").write_text(entry)
        assert runs_under_way() == [run]
