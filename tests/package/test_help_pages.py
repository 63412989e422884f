"""Help pages, refusals and tables of every command at the width of an ordinary terminal."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.main import get_command

from drftjax.commands.main import app

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("drftjax", "identify", "hils", "diagnose")
OF_A_RUN = ("--port", "/dev/null", "--profile", "data/paper.toml", "-o", "run.h5")
COLUMNS = 80
WIDE = 400  # wider than any line of a help page


def commands(command=None, path=("drft",), parent=None) -> Iterator[tuple]:
    """Each command with its words and its context."""
    command = command or get_command(app)
    context = command.make_context(path[-1], [], parent=parent, resilient_parsing=True)
    yield command, path, context
    for name in getattr(command, "commands", ()):
        yield from commands(command.get_command(context, name), (*path, name), context)


EVERY = [pytest.param(*each, id="-".join(each[1])) for each in commands()]


@pytest.mark.parametrize(("command", "path", "context"), EVERY)
def test_a_help_page_fits_a_terminal_without_a_broken_word(command, path, context, monkeypatch):
    pages = {}
    for width in (COLUMNS, WIDE):
        monkeypatch.setenv("COLUMNS", str(width))
        context.max_content_width = width
        pages[width] = command.get_help(context)
    assert [line for line in pages[COLUMNS].splitlines() if len(line) > COLUMNS] == []
    assert set(pages[COLUMNS].split()) == set(pages[WIDE].split())


@pytest.mark.parametrize(("command", "path", "context"), EVERY)
def test_all_that_is_missing_is_named_at_once(drft, command, path, context):
    required = [each for each in command.params if getattr(each, "required", False)]
    if not required:
        return
    answer = drft(*path[1:])
    assert answer.code == 2
    usage, _, refusal = answer.err.partition("Error: ")
    assert usage.startswith(f"Usage: {' '.join(path)} ")
    assert refusal.startswith("Missing ")
    for each in required:
        assert each.get_error_hint() in refusal
    assert refusal.count("option '") + refusal.count("argument '") == len(required)


def test_what_was_given_is_not_called_missing(drft):
    answer = drft("hils", "run", "--profile", "paper.toml")
    assert "Missing option '--port' and option '-o' / '--output'.\n" in answer.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("log", "check", "x", "--time-limit", "soon"), "'--time-limit': 'soon' must be a valid"),
        (("fit", "x", "--starts", "2.5"), "'--starts': '2.5' must be a valid integer"),
        (("design", "--steps", "0"), "'--steps': '0' must be greater than or equal to 1"),
        (("diagnose", "x", "--bed", "wet"), "'--bed': 'wet' is not one of 'prepared', 'free'"),
        (("design", "--loads", "1", "x"), "'--loads': ('1', 'x') must be a valid number"),
        (("blind", "make", "x", "--seed", "-1"), "'-1' must be greater than or equal to 0"),
        (("blind", "make", "x", "--sets", "9" * 14), "sets were asked for, must be 1 to 100000"),
        (("hils", "paper", "--tick", "nan"), "tick is nan, must lie between 0.0005 and 0.1 s"),
        (
            ("hils", "run", *OF_A_RUN, "--repeat", "9" * 11),
            f"'{'9' * 11}' must be less than or equal to 1000",
        ),
    ],
)
def test_a_refused_value_is_shown(drft, words, said):
    answer = drft(*words)
    assert answer.code == 2
    assert said in answer.err


def test_tables_of_commands_break_no_word(drft, monkeypatch):
    for words in (("effects",), ("log", "show", ROOT / "data" / "runs" / "fast.h5")):
        pages = []
        for width in (COLUMNS, WIDE):
            monkeypatch.setenv("COLUMNS", str(width))
            answer = drft(*words)
            assert answer.code == 0
            pages.append(answer.out)
        assert set(pages[0].split()) == set(pages[1].split())
        # Sentences before or after a table stay in one line where the output is no terminal.
        lines = pages[0].splitlines()
        table = lines[:-2] if words[0] == "effects" else lines[4:]
        assert len(table) > 5
        assert max(len(line.rstrip()) for line in table) <= COLUMNS


def test_every_table_is_one_that_breaks_no_word():
    own = {ROOT / "drftjax" / "common" / "rich_text.py"}
    own.add(ROOT / "hils" / "monitor" / "dashboard.py")  # the live view has a page of its own
    sources = [each for package in PACKAGES for each in (ROOT / package).rglob("*.py")]
    assert {each for each in sources if "rich.table" in each.read_text()} == own
