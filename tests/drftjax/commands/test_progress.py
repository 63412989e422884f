"""Progress of a long command."""

import io
import time

from rich.console import Console

from drftjax.commands.progress import LINE_INTERVAL, progress_line


def told(capsys, *, quiet: bool = False, terminal: bool = False) -> str:
    console = Console(file=io.StringIO(), force_terminal=terminal)
    with progress_line(console, "reading runs", quiet=quiet, interval=0.05) as show:
        time.sleep(0.1)
        show("fit: step 3")
        time.sleep(0.1)
    before = capsys.readouterr().err
    time.sleep(0.1)
    assert not capsys.readouterr().err  # Nothing is said after the end.
    return before


def test_a_log_gets_a_line_with_the_stage_from_time_to_time(capsys):
    lines = told(capsys).splitlines()
    assert lines[0] == "reading runs (0 s)"
    assert lines[-1] == "fit: step 3 (0 s)"
    assert LINE_INTERVAL == 10.0


def test_a_terminal_and_a_quiet_command_get_no_lines(capsys):
    assert not told(capsys, terminal=True)
    assert not told(capsys, quiet=True)


def test_a_stage_may_count_its_pieces_later(capsys):
    with progress_line(Console(file=io.StringIO()), "compiling", interval=0.05) as show:
        time.sleep(0.08)
        show("posterior: draws", 2, 8)
        time.sleep(0.08)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "compiling (0 s)"
    assert lines[-1] == "posterior: draws: 2 of 8 (0 s)"


def test_a_terminal_has_a_bar_where_pieces_are_counted():
    screens = []
    for pieces in ((), (2, 8)):
        console = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None)
        with progress_line(console, "compiling") as show:
            show("posterior: draws", *pieces)
        screens.append(console.file.getvalue())
    assert "2/8" in screens[1]
    assert "━" in screens[1]
    assert "/" not in screens[0]
    assert "━" not in screens[0]


def test_pieces_that_are_done_stand_in_the_line(capsys):
    with progress_line(Console(file=io.StringIO()), "fits", total=7, interval=0.05) as show:
        show("fits on 2 workers", 3)
        show("fits on 1 worker")
        time.sleep(0.1)
    assert capsys.readouterr().err.splitlines()[-1] == "fits on 1 worker: 3 of 7 (0 s)"
