"""`drft diagnose`: find the effects that make recorded runs differ from the model."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from drftjax.commands.options import remove_empty_folders
from drftjax.common.errors import InputError

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
@remove_empty_folders
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
    bed: Annotated[
        Literal["prepared", "free"],
        typer.Option(
            help="prepared: all runs have about one zeta, and what it does between conditions is "
            "part of the gap. free: nobody prepared the bed, and each run has its own."
        ),
    ] = "prepared",
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the verdict alone.")] = False,
) -> None:
    """Find which effect makes runs of a rig differ from the model, where, and by how much."""
    from dataclasses import replace

    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from diagnose.api import diagnose_gathered, effects_among
    from diagnose.linear.bed import BEDS
    from diagnose.report.budget_text import budget_table
    from diagnose.report.model_writer import MODEL_FILE_MARK
    from diagnose.report.text import gap_table, paragraphs, verdict, write
    from diagnose.rig_runs import gather_runs
    from diagnose.settings import DEFAULT_SETTINGS
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_places
    from drftjax.common.text import replace_unprintable
    from drftjax.results.provenance import command_provenance
    from drftjax.setups.generated_files import require_own_setup

    chosen, settings = effects_among(_names(effects)), DEFAULT_SETTINGS.with_bed(BEDS[bed])
    if output is not None:
        require_places(output / name for name in ("diagnosis.json", "report.html", "model.toml"))
        require_own_setup(output / "model.toml", MODEL_FILE_MARK)
    made = command_provenance("diagnose", runs, DEFAULT_SETTINGS.localization.seed)
    console = Console()

    def say(text: str, style: str | None = None) -> None:
        # File names may hold brackets, and are to be copied from one line.
        console.print(
            replace_unprintable(text), style=style, markup=False, highlight=False, soft_wrap=True
        )

    with progress_line(console, "reading runs", quiet=quiet) as show:
        gathered = gather_runs(runs, lambda left_out: say(left_out, "yellow"))
        found = diagnose_gathered(
            gathered, chosen, show, lambda left_out: say(left_out, "yellow"), settings
        )

    say(verdict(found), "bold")
    if not quiet:
        console.print(budget_table(found))
        console.print(gap_table(found))
        for paragraph in paragraphs(found):
            say(paragraph)
    if output is not None:
        written = write(replace(found, provenance=made), output)
        if not quiet:
            say(f"written: {', '.join(str(each) for each in written)}")


def _names(given: str | None) -> list[str] | None:
    """Names of effects with commas between; nothing where none are asked for.

    Raises:
        InputError: for a text that names none.
    """
    if given is None:
        return None
    names = [each.strip() for each in given.split(",") if each.strip()]
    if not names:
        raise InputError("--effects names no effect; `drft effects` lists them")
    return names


if __name__ == "__main__":
    app()
