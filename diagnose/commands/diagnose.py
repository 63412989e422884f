"""`drft diagnose`: find the effects that make recorded runs differ from the model."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from drftjax.commands.options import (
    PlotFile,
    complete_effects,
    draw_picture,
    remove_empty_folders,
    require_picture,
)
from drftjax.commands.printing import say_next, say_on
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    # From effects, a report of stages and one of skipped runs: result, words, writer.
    Steps = Callable[..., tuple[Any, list[Any], Callable[[Any, Path], list[Path]]]]

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

  drft diagnose runs/*.h5 -o out/diagnosis

  drft diagnose runs/ --effects loosening,vertical_spring,bulldozing

  drft diagnose now/ --against before/ -o out/change

With --against, runs of one rig and the same commands are compared: what changed since, whatever
both share.

The folder given by -o holds diagnosis.json, model.toml (the model with what was found) and
report.html (one page, to open in a browser). `drft evaluate --model out/diagnosis/model.toml
OTHER_RUNS` holds the model against runs that it was not found on. With --against there is no
model.toml.
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
    picture: PlotFile = None,
    effects: Annotated[
        str | None,
        typer.Option(
            help="Names, with commas between: only these are considered, in all their forms. "
            "[default: all]",
            autocompletion=complete_effects,
        ),
    ] = None,
    bed: Annotated[
        Literal["prepared", "free"],
        typer.Option(
            help="prepared: all runs have about one zeta, and what it does between conditions is "
            "part of the gap. free: nobody prepared the bed, and each run has its own."
        ),
    ] = "prepared",
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the verdict alone.")] = False,
    against: Annotated[
        Path | None,
        typer.Option(help="Runs of the same rig before: find what changed.", show_default=False),
    ] = None,
) -> None:
    """Find which effect makes runs of a rig differ from the model, where, and by how much."""
    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from diagnose.api import effects_among
    from drftjax.commands.progress import progress_line

    if against is not None and bed != "prepared":
        raise InputError(
            f"--bed {bed} says nothing with --against: a comparison lets zeta differ "
            "from run to run by what repeats show; leave one of the two out"
        )
    require_picture(picture, [*runs, *([] if against is None else [against])])
    chosen = effects_among(_names(effects))
    console = Console()
    say = partial(say_on, console)

    steps = _diagnosed(runs, output, bed) if against is None else _compared(runs, against, output)
    with progress_line(console, "reading runs", quiet=quiet) as show:
        found, words, write = steps(chosen, show, lambda left_out: say(left_out, "yellow"))

    first, *others = words
    say(first, "bold")
    if not quiet:
        for each in others:
            if isinstance(each, str):
                say(each)
            else:
                console.print(each)
    if output is not None:
        written = write(found, output)
        if not quiet:
            say(f"written: {', '.join(str(each) for each in written)}")
            if against is None:
                say_next("evaluate", "OTHER_RUNS", "--model", output / "model.toml")
    if picture is not None:
        draw_picture(found.plot(), picture)


def _diagnosed(runs: list[Path], output: Path | None, bed: str) -> "Steps":
    """Steps of a diagnosis, once its result's files are known to have a place."""
    from dataclasses import replace

    from diagnose.api import diagnose_gathered
    from diagnose.linear.bed import BEDS
    from diagnose.report.model_writer import MODEL_FILE_MARK
    from diagnose.report.page import write
    from diagnose.report.text import in_words
    from diagnose.rig_runs import gather_runs
    from diagnose.settings import DEFAULT_SETTINGS
    from drftjax.common.output_files import require_places
    from drftjax.results.provenance import command_provenance
    from drftjax.setups.generated_files import require_own_setup

    if output is not None:
        require_places(output / name for name in ("diagnosis.json", "report.html", "model.toml"))
        require_own_setup(output / "model.toml", MODEL_FILE_MARK)
    made = command_provenance("diagnose", runs, DEFAULT_SETTINGS.localization.seed)

    def steps(effects, report, tell):
        settings = DEFAULT_SETTINGS.with_bed(BEDS[bed])
        found = diagnose_gathered(gather_runs(runs, tell), effects, report, tell, settings)
        return replace(found, provenance=made), in_words(found), write

    return steps


def _compared(runs: list[Path], against: Path, output: Path | None) -> "Steps":
    """Steps of a comparison with the runs before, likewise."""
    from dataclasses import replace

    from diagnose.api import compare_gathered
    from diagnose.change.comparison import DEFAULT_CHANGE_SETTINGS
    from diagnose.change.report import in_words, write
    from diagnose.rig_runs import gather_runs
    from drftjax.common.output_files import require_places
    from drftjax.results.provenance import command_provenance

    if output is not None:
        require_places(output / name for name in ("diagnosis.json", "report.html"))
    seed = DEFAULT_CHANGE_SETTINGS.relabelling.seed
    made = command_provenance("diagnose", [*runs, against], seed)

    def steps(effects, report, tell):
        before = gather_runs([against], tell)
        now = gather_runs(runs, tell, before.runs[0].setup.start.origin)
        found = compare_gathered(before, now, effects, report, tell)
        return replace(found, provenance=made), in_words(found), write

    return steps


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
