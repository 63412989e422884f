"""`drft diagnose`: recorded runs in; what makes them differ from the model, and how much, out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.errors import InputError

if TYPE_CHECKING:
    from diagnose.diagnosis import Diagnosis
    from diagnose.search import Report
    from drftjax.effects.stage import AbstractEffect
    from identify.candidate import Candidate

app = typer.Typer(add_completion=False, rich_markup_mode=None)

EXAMPLES = """
Examples:

  drft diagnose runs/*.h5 -o out/diagnosis

  drft diagnose runs/ --effects loosening,vertical_spring,bulldozing

The folder given by -o holds diagnosis.json, model.toml (the model with what was found) and
report.html (one page, to open in a browser). `drft evaluate --model out/diagnosis/model.toml
OTHER_RUNS` holds the model against runs that it was not found on.
"""


@app.command(epilog=EXAMPLES)
def diagnose(
    runs: Annotated[
        list[Path], typer.Argument(help="Run logs, or folders of them.", show_default=False)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder of the result's files.")
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(help="Names, with commas between: only these are considered. [default: all]"),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the verdict alone.")] = False,
) -> None:
    """Find which effect makes runs of a rig differ from the model, where, and by how much."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from drftjax.commands.runtime import configure_jax

    configure_jax()
    from diagnose.report import gap_table, paragraphs, verdict, write
    from diagnose.runs import gather
    from drftjax.runlog.content import printable
    from drftjax.runlog.replace import require_folder

    chosen = named_effects(effects)
    if output is not None:
        require_folder(output)
    console = Console()

    def say(text: str, style: str | None = None) -> None:
        # File names may hold brackets, and are to be copied from one line.
        console.print(printable(text), style=style, markup=False, highlight=False, soft_wrap=True)

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
        task = bar.add_task("reading runs", total=None)
        gathered = gather(runs, lambda left_out: say(left_out, "yellow"))

        def report(stage: str) -> None:
            bar.update(task, description=stage)

        found = _diagnosed(gathered.candidates, gathered.left_out, chosen, report, say)

    say(verdict(found), "bold")
    if not quiet:
        console.print(gap_table(found))
        for paragraph in paragraphs(found):
            say(paragraph)
    if output is not None:
        written = write(found, output)
        if not quiet:
            say(f"written: {', '.join(str(each) for each in written)}")


def named_effects(names: str | None) -> "tuple[type[AbstractEffect], ...]":
    """Effects by their names with commas between; the whole catalogue where none are given.

    Raises:
        InputError: for a name that is not known, with the nearest ones that are.
    """
    from drftjax.effects.catalogue import catalogue, effect_class

    if names is None:
        return tuple(catalogue().values())
    wanted = [each.strip() for each in names.split(",") if each.strip()]
    if not wanted:
        raise InputError("--effects names no effect; `drft effects` lists them")
    return tuple(effect_class(each) for each in dict.fromkeys(wanted))


def _diagnosed(
    candidates: "list[Candidate]",
    left_out: dict[str, str],
    effects: "tuple[type[AbstractEffect], ...]",
    report: "Report",
    say,
) -> "Diagnosis":
    """The diagnosis of the runs that the reference model can follow at all."""
    import dataclasses

    from diagnose.case import Case, threads
    from diagnose.diagnosis import diagnose as diagnosis_of
    from diagnose.where import where

    kept, notes = list(candidates), list(left_out.values())
    with threads() as pool:
        while True:
            try:
                found = diagnosis_of(Case.of(kept, pool), effects, report)
                break
            except InputError as problem:
                why = str(problem)
                others = [each for each in kept if not why.startswith(f"{each.name}: ")]
                if not others or len(others) == len(kept):
                    raise
                kept = others
                notes.append(why)
                say(f"left out: {why}", "yellow")
    return dataclasses.replace(
        found,
        where=found.where or where(found.case, found.before, dict(found.floors)),
        notes=[*found.notes, *(f"Left out: {n}" for n in notes)],
    )


if __name__ == "__main__":
    app()
