"""Sentences of commands, in a terminal and elsewhere."""

import io
import sys
from pathlib import Path

import pytest
from rich.console import Console

from drftjax.commands.printing import say, say_next, say_on

SENTENCE = "  to tell loosening from speed_gain: run 3_backward.toml, where z differs by 0.31 mm"
NAME = "out/" + "a_long_folder/" * 5 + "run.h5"


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("with_console", [False, True])
@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_a_terminal_gets_whole_words_and_a_file_whole_lines(monkeypatch, stream, with_console):
    monkeypatch.setenv("COLUMNS", "40")
    written = stream()
    monkeypatch.setattr("sys.stdout", written)
    text = f"{SENTENCE} {NAME}"
    if with_console:
        say_on(Console(width=40, color_system=None), text)
    else:
        say(text)
    lines = written.getvalue().splitlines()
    assert [word for line in lines for word in line.split()] == text.split()
    if stream is Terminal:
        assert len(lines) > 1
        assert all(len(line.rstrip()) <= 40 or line.strip() == NAME for line in lines)
    else:
        assert lines == [text]


def test_lines_of_a_text_stay_lines_and_errors_go_to_their_stream(capsys):
    say("one\n  two", error=True)
    assert tuple(capsys.readouterr()) == ("", "one\n  two\n")


def test_the_next_command_can_be_copied_as_it_stands(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr("sys.stdout", Terminal())
    say_next("evaluate", "OTHER_RUNS", "--model", Path("out of doors/model.toml"))
    said = sys.stdout.getvalue()
    assert said == "next: drft evaluate OTHER_RUNS --model 'out of doors/model.toml'\n"


def test_brackets_are_no_markup_and_control_characters_are_not_printed(capsys):
    say_on(Console(), "[red]run[a].h5\x1b[2J")
    assert capsys.readouterr().out == "[red]run[a].h5\ufffd[2J\n"
