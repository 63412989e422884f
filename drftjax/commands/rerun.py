"""`drft rerun`: make a result again by its recorded command line, and tell what differs."""

import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drftjax.commands.options import remove_empty_folders
from drftjax.commands.printing import say_on
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from drftjax.common.rich_text import WholeWordTable
    from drftjax.results.command_line import ResultCommand
    from drftjax.results.differences import ResultComparison, ResultDifference
    from drftjax.results.provenance import Machine

app = typer.Typer(add_completion=False, rich_markup_mode=None)


# Rows of the table of differences; the weightiest come first, and both files hold all.
MOST_ROWS = 20


EXAMPLES = """
Examples:

\b
  drft rerun out/fit.json         makes out/fit_rerun.json, .h5, .png, .html
  drft rerun out/diagnosis/diagnosis.json -o out/again
  drft rerun colleague/fit.json --changed-inputs

Takes the result of fit, crosscheck, design, diagnose or evaluate. Its inputs are looked for from
the current directory, from the result's folder and from those above it, and must be the same files,
by SHA-256. Ends with 0 where nothing but rounding differs, with 1 where something does, and with 2
where the result cannot be made again.
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def rerun(
    result: Annotated[Path, typer.Argument(help="A result (JSON).", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Stem of the new result's files, or a diagnosis's folder. [default: a new name "
            "beside the result, with _rerun]",
        ),
    ] = None,
    changed_inputs: Annotated[
        bool, typer.Option("--changed-inputs", help="Run with inputs that have changed, too.")
    ] = False,
) -> None:
    """Make a result again from its recorded command line and inputs, and say what differs."""
    from rich.console import Console

    from drftjax.commands.main import subcommand
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_folder
    from drftjax.results.command_line import (
        RESULT_COMMANDS,
        find_inputs,
        parse_recorded,
        relative_to_base,
        require_known_command,
    )
    from drftjax.results.differences import compare_results
    from drftjax.results.provenance import read_result_document, software_versions

    before, document = read_result_document(result)
    if (made := document.provenance) is None:
        raise InputError(
            f"{result}: holds no provenance, as results of older versions do not; without its "
            "command line it cannot be made again"
        )
    name = require_known_command(made.command, result)
    assert made.command is not None
    kind = RESULT_COMMANDS[name]
    command, option = parse_recorded(made.command, document.schema, subcommand(name), result)
    inputs = find_inputs(command, made, result)
    if inputs.changes and not changed_inputs:
        raise InputError(
            f"{result}: {'; '.join(inputs.changes)}; give --changed-inputs to run with it as it is"
        )
    asked, target = kind.result(_fresh(kind.stem(result), kind) if output is None else output)
    require_folder(asked.absolute().parent)
    earlier = _stamp(target)

    console = Console()
    say = partial(say_on, console)

    for each in inputs.changes:
        say(each, "yellow")
    for each in _changed(made.versions, software_versions()):
        say(each, "yellow")
    arguments = command.arguments(relative_to_base(asked, inputs.base), option)
    with progress_line(console, f"drft {name}"):
        _run(arguments, inputs.base, result)
    if _stamp(target) == earlier:
        raise InputError(f"{result} cannot be made again: drft {name} finds no result to write")
    after, again = read_result_document(target)
    if again.provenance is not None:
        for each in _changed(_numbers(made.machine), _numbers(again.provenance.machine)):
            say(each, "yellow")
    try:
        found = compare_results(before, after)
    except RecursionError:
        raise InputError(f"{result}: its entries lie too deep to be compared") from None
    if found.differences:
        console.print(_table(found.differences[:MOST_ROWS]))
    say(f"written: {target}")
    say(_summary(found))
    if found.differences:
        raise typer.Exit(1)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Inode and time of a file, which change as it is replaced; None where there is none."""
    if not path.exists():
        return None
    found = path.stat()
    return found.st_ino, found.st_mtime_ns


def _fresh(stem: Path, kind: "ResultCommand") -> Path:
    """The first free name beside a result: STEM_rerun, STEM_rerun_2, ..."""
    tails = chain(["_rerun"], (f"_rerun_{number}" for number in count(2)))
    names = (stem.with_name(stem.name + tail) for tail in tails)
    return next(each for each in names if not each.exists() and not kind.result(each)[1].exists())


def _run(arguments: Sequence[str], folder: Path, result: Path) -> None:
    """Run `drft` in a child process, its output unseen.

    Raises:
        InputError: by its own reason, where it makes no result.
    """
    from drftjax.common.child_process import program

    start = [sys.executable, "-I", "-c", program("drftjax.commands.main", "main")]
    ended = subprocess.run(
        [*start, *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        check=False,
    )
    if ended.returncode:
        said = [line for line in ended.stderr.splitlines() if line.startswith("drft: ")]
        why = said[-1].removeprefix("drft: ") if said else f"it ended with {ended.returncode}"
        raise InputError(f"{result} cannot be made again: {why}")


def _numbers(machine: "Machine") -> dict[str, str]:
    from msgspec.structs import asdict

    return {name: str(value) for name, value in asdict(machine).items()}


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Sentences on entries of provenance that are others than they were."""
    return [
        f"{name} was {before.get(name, 'not reported')}, is {after.get(name, 'not reported')}"
        for name in dict.fromkeys([*before, *after])
        if before.get(name) != after.get(name)
    ]


def _summary(found: "ResultComparison") -> str:
    """The outcome in one sentence."""
    entries = len(found.differences)
    differ = {0: "nothing differs", 1: "one entry differs"}.get(
        entries, f"{entries} entries differ"
    )
    if entries > MOST_ROWS:
        differ += f" ({MOST_ROWS} are shown)"
    if not found.rounded:
        others = "the other numbers are" if entries else f"all {found.numbers} numbers are"
        return f"{differ}; {others} the same to the last bit"
    return (
        f"{differ} by more than rounding; {found.rounded} of {found.numbers} numbers are rounded "
        f"otherwise, by at most {found.largest_rounding:.1g} of them"
    )


def _table(differences: "Sequence[ResultDifference]") -> "WholeWordTable":
    from rich.markup import escape

    from drftjax.common.rich_text import WholeWordTable
    from drftjax.common.text import replace_unprintable

    table = WholeWordTable(title="what differs", title_justify="left")
    for heading in ("entry", "before", "again"):
        table.add_column(heading)
    table.add_column("difference", justify="right")
    for each in differences:
        cells = (each.place, each.before, each.after)
        table.add_row(*(escape(replace_unprintable(cell)) for cell in cells), each.size)
    return table
