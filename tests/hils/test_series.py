"""A series of runs: who asks for an end ends all of it, whatever is being done at that moment."""

import dataclasses
import io
import os
import signal
import subprocess
import sys
import termios
import threading
from contextlib import suppress
from typing import ClassVar

import psutil
import pytest

from drftjax.common.errors import InputError
from hils import series as series_module
from hils.control.loop_report import LoopStatistics
from hils.control.stop_request import STOP_SIGNAL, StopReason, StopRequest
from hils.events import Event
from hils.procedure.active_runs import runs_under_way
from hils.procedure.operator_prompts import TerminalPrompts, UnattendedPrompts
from hils.procedure.procedure import Procedure, ProcedureSettings, RunReport, run
from hils.recording.sinks import InMemorySink
from hils.rig_sim.in_process import soft_rig
from hils.series import ENDED_EARLY, INTERRUPTED, Series, file_names, make_series, outcome_lines
from tests.helpers.hils_runs import loop_setup, make

CTRL_C = StopReason("interrupted by Ctrl-C", Event.INTERRUPTED, signal.SIGINT)
TERMINATED = StopReason("asked to stop (SIGTERM)", Event.INTERRUPTED, signal.SIGTERM)
PATIENCE = 60.0  # a busy machine starts a thread late [s]


class AtTheEnd(InMemorySink):
    """Does something while the file is being closed."""

    stop = None

    def __init__(self, act):
        super().__init__()
        self._act = act

    def close(self, end_reason):
        super().close(end_reason)
        self._act(self)


def closed_with(act) -> tuple[RunReport, AtTheEnd]:
    rows = AtTheEnd(act)
    report = make(cue=lambda stop, link: setattr(rows, "stop", stop), rows=rows).report
    assert report is not None
    return report, rows


def test_stop_that_comes_while_the_file_is_closed_is_in_the_report(tmp_path):
    report, _ = closed_with(lambda rows: rows.stop.ask(TERMINATED))
    assert report.completed
    assert report.stop_reason == TERMINATED
    assert "No further run: asked to stop (SIGTERM)." in outcome_lines(report, tmp_path / "run.h5")


def test_a_run_without_a_reading_is_told_to_leave_no_file(tmp_path):
    report = make().report
    assert report is not None
    loop = report.loop
    assert loop is not None
    blind = dataclasses.replace(report, loop=loop._replace(statistics=LoopStatistics(room=0)))
    assert outcome_lines(blind, tmp_path / "run.h5")[-1].startswith("No run log: no reading came")
    assert outcome_lines(report, tmp_path / "run.h5")[-1].startswith("Link: ")


def test_a_file_that_came_to_stand_there_meanwhile_is_not_told_as_the_run_log(tmp_path):
    report, path = make().report, tmp_path / "run.h5"
    assert report is not None
    path.write_bytes(b"another run")
    assert outcome_lines(report, path)[-1] == f"Run log: {path}"
    (tmp_path / "run.h5.part").write_bytes(b"rows")
    assert outcome_lines(report, path)[-1].startswith("Link: ")


def test_file_that_cannot_be_finished_does_not_hide_how_the_run_went():
    def fail(rows):
        raise InputError("run.h5: the recorder could not finish")

    report, _ = closed_with(fail)
    assert report.completed
    assert report.rested
    assert report.unfinished == "run.h5: the recorder could not finish"


@pytest.fixture
def runs(monkeypatch, tmp_path):
    """Makes a series of three whose runs end as they are told to; how many were made."""
    monkeypatch.setattr("hils.procedure.active_runs.REGISTRY_PARENT", tmp_path)
    whole = make().report
    assert whole is not None

    def these(between=None, **changes) -> tuple[int, int]:
        made = []

        def make_run(*given):
            made.append(given)
            return dataclasses.replace(whole, **changes)

        monkeypatch.setattr(series_module, "make_run", make_run)
        monkeypatch.setattr(series_module, "_prepare", between or (lambda *_: None))
        files = [tmp_path / f"run-{number}.h5" for number in range(3)]
        given = Series("/dev/rig", 115_200, files, None, fifo=False)
        code = make_series(Procedure(loop=loop_setup()), given, UnattendedPrompts(quiet=True))
        return code, len(made)

    return these


def test_series_goes_on_while_runs_are_completed(runs):
    assert runs() == (0, 3)


def test_series_ends_where_a_safety_rule_fired_though_the_run_was_completed(runs):
    assert runs(findings=("the scale was stuck",)) == (ENDED_EARLY, 1)


@pytest.mark.parametrize(("wish", "code"), [(CTRL_C, INTERRUPTED), (TERMINATED, ENDED_EARLY)])
def test_series_ends_where_an_end_was_asked_for_though_the_run_was_completed(runs, wish, code):
    assert runs(stop_reason=wish) == (code, 1)


def test_a_stop_in_the_last_instant_before_it_would_be_raised_ends_the_series(runs, monkeypatch):
    class Late(StopRequest):
        """Is asked between the look at the wish and `uninterruptible`."""

        @property
        def uninterruptible(self):
            return self._uninterruptible

        @uninterruptible.setter
        def uninterruptible(self, value):
            if not value and hasattr(self, "_uninterruptible"):
                self.ask(TERMINATED)
            self._uninterruptible = value

    monkeypatch.setattr(series_module, "StopRequest", Late)
    assert runs() == (ENDED_EARLY, 1)


def test_series_ends_where_the_rig_was_not_seen_to_rest(runs):
    """What prepares the sand would meet a wheel that turns."""
    assert runs(rested=False) == (ENDED_EARLY, 1)


def test_file_that_could_not_be_finished_ends_the_series_with_its_sentence(runs):
    with pytest.raises(InputError, match="the disk is full"):
        runs(unfinished="the disk is full")


def test_series_can_be_found_and_stopped_between_its_runs(runs, tmp_path):
    found = []

    def between(*given):
        found.extend(runs_under_way())
        signal.raise_signal(signal.SIGTERM)

    assert runs(between=between) == (ENDED_EARLY, 1)
    (each,) = found
    assert each.port == "/dev/rig"
    assert each.output == f"{tmp_path}/run-0.h5 to {tmp_path}/run-2.h5"
    assert runs_under_way() == []


def test_emergency_stop_after_the_profile_is_called_so(tmp_path):
    pressed = StopReason("asked for by the operator", Event.EMERGENCY_STOP, signal.SIGUSR1)
    report, _ = closed_with(lambda rows: rows.stop.ask(pressed, emergency=True))
    said = "No further run: emergency stop: asked for by the operator."
    assert said in outcome_lines(report, tmp_path / "run.h5")


def test_second_stop_while_the_file_is_closed_is_called_no_emergency_stop():
    def twice(rows):
        rows.stop.ask(TERMINATED)
        rows.stop.ask(TERMINATED)

    report, _ = closed_with(twice)
    assert report.stop_reason == TERMINATED


def test_ctrl_c_between_runs_interrupts_the_program(runs):
    with pytest.raises(KeyboardInterrupt):
        runs(between=lambda *_: signal.raise_signal(signal.SIGINT))


def test_operator_is_told_of_a_recording_that_takes_long_to_close():
    told, said = threading.Event(), []

    class Slow(InMemorySink):
        def close(self, end_reason):
            assert told.wait(PATIENCE)
            super().close(end_reason)

    class Listener(UnattendedPrompts):
        def say(self, text):
            said.append(text)
            if "closed" in text:
                told.set()

    rows, soft = Slow(), soft_rig()
    soon = ProcedureSettings(close_notice_time=0.01)
    given = Procedure(loop=loop_setup(), countdown=0.3, settings=soon)
    report = run(given, soft.link, soft.clock, rows, Listener(quiet=True), StopRequest())
    assert report.completed
    assert rows.end_reason == "completed"
    assert said[-1] == "The recording is being closed, for 120 s at most."


def test_a_stop_that_comes_while_a_run_is_told_lets_it_be_told(monkeypatch, tmp_path):
    monkeypatch.setattr("hils.procedure.active_runs.REGISTRY_PARENT", tmp_path)

    class Heard(UnattendedPrompts):
        lines: ClassVar[list[str]] = []

        def say(self, text):
            if not self.lines:
                signal.raise_signal(STOP_SIGNAL)
            self.lines.append(text)

    def make_run(procedure, series, path, prompts, stop, under_way):
        stop.uninterruptible = True  # as from ARM on
        return make().report

    monkeypatch.setattr(series_module, "make_run", make_run)
    given = Series("/dev/rig", 115_200, [tmp_path / "run.h5"], None, fifo=False)
    code = make_series(Procedure(loop=loop_setup()), given, Heard(quiet=True))
    assert code == ENDED_EARLY
    assert Heard.lines[0] == "Completed."
    assert Heard.lines[-1].startswith("Link: ")


LEAVER = """
import signal, sys
from hils.control.loop_report import LoopStatistics
from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL, StopRequest
with StopRequest().on_signals():
    pass
for each in (STOP_SIGNAL, EMERGENCY_SIGNAL):
    signal.raise_signal(each)
sys.exit(3)
"""


def test_a_stop_that_finds_the_program_leaving_does_not_spoil_its_exit_code():
    assert subprocess.run([sys.executable, "-c", LEAVER]).returncode == 3


def test_what_the_command_between_runs_has_started_ends_with_it(monkeypatch, tmp_path):
    """A leveller that a script drives must not go on moving."""
    monkeypatch.setattr("hils.procedure.active_runs.REGISTRY_PARENT", tmp_path)
    monkeypatch.setattr(series_module, "make_run", lambda *_: make().report)
    told = tmp_path / "leveller"
    between = f"sleep 600 & echo $! > {told}; kill -USR2 {os.getpid()}; wait; echo never"
    given = Series("/dev/rig", 115_200, [tmp_path / "a.h5", tmp_path / "b.h5"], between, fifo=False)
    assert (
        make_series(Procedure(loop=loop_setup()), given, UnattendedPrompts(quiet=True))
        == ENDED_EARLY
    )
    # It has ended; nobody may have collected its exit code yet.
    with suppress(psutil.NoSuchProcess):
        assert psutil.Process(int(told.read_text())).status() == psutil.STATUS_ZOMBIE


def test_a_stop_while_the_command_between_runs_starts_ends_it(monkeypatch, tmp_path):
    monkeypatch.setattr("hils.procedure.active_runs.REGISTRY_PARENT", tmp_path)
    monkeypatch.setattr(series_module, "make_run", lambda *_: make().report)
    started = []

    class Interrupted(subprocess.Popen):
        def __init__(self, *given, **named):
            super().__init__(*given, **named)
            started.append(self)
            signal.raise_signal(STOP_SIGNAL)

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    files = [tmp_path / "a.h5", tmp_path / "b.h5"]
    nap = str(600 + os.getpid() / 10**8)  # as no other process sleeps
    given = Series("/dev/rig", 115_200, files, f"sleep {nap}; echo never", fifo=False)
    assert (
        make_series(Procedure(loop=loop_setup()), given, UnattendedPrompts(quiet=True))
        == ENDED_EARLY
    )
    (shell,) = started
    assert shell.poll() is not None
    running = [each.info["cmdline"] or [] for each in psutil.process_iter(["cmdline"])]
    assert ["sleep", nap] not in running


def test_a_recording_left_behind_is_refused_before_the_first_run(tmp_path):
    (tmp_path / "run-02.h5.part").write_bytes(b"rows")
    with pytest.raises(InputError, match=r"run-02\.h5\.part is already there"):
        file_names(tmp_path / "run.h5", 2)


def test_a_new_folder_is_made_and_one_that_cannot_be_is_refused_before_anything_moves(tmp_path):
    names = file_names(tmp_path / "day" / "sand" / "run.h5", 2)
    assert [each.name for each in names] == ["run-01.h5", "run-02.h5"]
    assert (tmp_path / "day" / "sand").is_dir()
    (tmp_path / "taken").write_bytes(b"")
    with pytest.raises(InputError, match="taken cannot be made a folder"):
        file_names(tmp_path / "taken" / "run.h5", 1)


SPEAKER = """
import sys
from hils.procedure.operator_prompts import TerminalPrompts, UnattendedPrompts
for each in (TerminalPrompts(), UnattendedPrompts()):
    for number in range(3):
        each.say(f"sentence {number}")
sys.stdout.flush()
sys.exit(3)
"""


def test_what_nobody_reads_any_more_ends_nothing_and_leaves_the_exit_code():
    reader, output = os.pipe()
    os.close(reader)
    said = subprocess.run([sys.executable, "-c", SPEAKER], stdout=output, stderr=subprocess.PIPE)
    os.close(output)
    assert said.returncode == 3
    assert said.stderr == b""


def test_a_question_that_nobody_can_read_is_refused(monkeypatch, capsys):
    def ask(_):
        raise BrokenPipeError

    monkeypatch.setattr("builtins.input", ask)
    with pytest.raises(InputError, match="nobody is at the terminal"):
        TerminalPrompts().confirm("Let the wheel down")


@pytest.fixture
def keyboard(monkeypatch):
    """The other end of the terminal that stands in for standard input."""
    master, slave = os.openpty()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        yield master
    os.close(master)


@pytest.mark.parametrize("typed_before", [b"", b"\n\n"])
def test_a_question_at_a_terminal_waits_for_an_enter_of_its_own(keyboard, typed_before):
    """What compiles first, or a run before, may keep a person waiting: who then types confirms."""
    looks = []

    def look():
        looks.append(1)
        if len(looks) == 3:
            os.write(keyboard, b"\n")

    if typed_before:
        os.write(keyboard, typed_before)
    TerminalPrompts().confirm("Let the wheel down", look)
    assert len(looks) >= 3


def test_what_may_be_lost_does_not_wait_for_a_halted_terminal(monkeypatch):
    master, slave = os.openpty()
    with os.fdopen(slave, "w") as terminal:
        monkeypatch.setattr("sys.stdout", terminal)
        termios.tcflow(terminal, termios.TCOOFF)  # as Ctrl-S does
        TerminalPrompts().say_if_free("Armed.")
        termios.tcflow(terminal, termios.TCOON)
        TerminalPrompts().say_if_free("Start in 3 s")
        monkeypatch.undo()
    assert os.read(master, 100) == b"Start in 3 s\r\n"
    os.close(master)


def test_what_is_met_meanwhile_ends_the_question(keyboard, capsys):
    def look():
        raise InputError("the rig made an emergency stop")

    with pytest.raises(InputError, match="made an emergency stop"):
        TerminalPrompts().confirm("Let the wheel down", look)
    assert capsys.readouterr().out.endswith(" \n")


def test_an_interrupted_question_leaves_its_line_closed(keyboard, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("select.select", interrupted)
    with pytest.raises(KeyboardInterrupt):
        TerminalPrompts().confirm("Let the wheel down")
    assert capsys.readouterr().out.endswith(" \n")


def test_a_terminal_that_is_closed_answers_nothing(keyboard):
    with pytest.raises(InputError, match="nobody is at the terminal"):
        TerminalPrompts().confirm("Let the wheel down", lambda: os.write(keyboard, b"\x04"))


def test_a_question_that_nobody_answers_leaves_its_line_closed(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(InputError, match="nobody is at the terminal"):
        TerminalPrompts().confirm("Let the wheel down")
    assert capsys.readouterr().out.endswith("\n")
