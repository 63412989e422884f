"""`drft blind`: sets of runs with faults drawn by lot, answers to them, and a score of those."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import CommandGroup
from drftjax.common.errors import InputError

app = typer.Typer(
    cls=CommandGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None
)


# Of sets without an answer so many are named.
MOST_NAMES = 10


@app.callback()
def blind() -> None:
    """Judge diagnoses on sets of runs whose faults are drawn by lot and sealed."""


MAKE_EXAMPLES = """
Examples:

  drft blind make out/blind --sets 300 --seed 7 --jobs 2

  drft blind make out/strong --sets 40 --protocol practice --faintest 10

  drft blind make out/pairs --sets 24 --wrong pair --faintest 3
"""


@app.command(epilog=MAKE_EXAMPLES)
def make(
    folder: Annotated[Path, typer.Argument(help="A new folder for the sets.")],
    sets: Annotated[int, typer.Option(help="How many sets.")] = 100,
    seed: Annotated[int, typer.Option(help="Settles every lot that is drawn.")] = 0,
    protocol: Annotated[
        str,
        typer.Option(
            help="'practice', 'random', or 'mixed': each set one or the other. 'telling': the rigs "
            "of 'mixed', on the runs of `drft protocol`."
        ),
    ] = "mixed",
    faintest: Annotated[float, typer.Option(help="Least gap wanted [floors].")] = 0.5,
    strongest: Annotated[float, typer.Option(help="Greatest gap wanted [floors].")] = 30.0,
    wrong: Annotated[
        str,
        typer.Option(
            help="What is wrong with every set: 'none', 'one', 'pair' or 'unknown' (an effect that "
            "the list lacks); 'mixed': some of each."
        ),
    ] = "mixed",
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Make sets of runs of rigs with something wrong, or nothing, and seal what it is."""
    from rich.progress import Progress

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from diagnose.blind.generation.generate import GenerationRequest
    from diagnose.blind.generation.generate import make as made

    order = GenerationRequest(folder, sets, seed, protocol, faintest, strongest, wrong)
    with Progress(transient=True) as bar:
        task = bar.add_task("making sets", total=sets)
        for _ in made(order, jobs):
            bar.advance(task)
    typer.echo(f"{sets} sets written to {folder}; their labels are sealed")


ANSWER_EXAMPLES = """
Example:

  drft blind answer out/blind -o out/answers.json --jobs 2

Each answer is written as it is found; with --resume, the file's own are kept and the other sets
answered. Labels are not looked at: the command works as well where there are none.
"""


@app.command(epilog=ANSWER_EXAMPLES)
def answer(
    folder: Annotated[Path, typer.Argument(help="A folder of sets.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the answers here (JSON).")],
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep the answers that the file has.")
    ] = False,
) -> None:
    """Diagnose every set of a folder from its runs alone."""
    from rich.progress import Progress

    from diagnose.blind.answers.answer import answer_sets, configure, runs_of
    from diagnose.blind.answers.answer_file import answers_in, write_answers
    from drftjax.common.output_files import require_places
    from drftjax.common.text import printable

    if output.suffix.lower() != ".json":
        raise InputError(f"{output}: a file of answers must end in .json")
    answers = answers_in(output) if resume and output.exists() else {}
    open_sets = {name: runs for name, runs in runs_of(folder).items() if name not in answers}
    configure()
    require_places([output])
    failures: dict[str, str] = {}
    with Progress(transient=True) as bar:
        task = bar.add_task("answering", total=len(open_sets))
        for name, found in answer_sets(open_sets, jobs):
            if isinstance(found, str):
                failures[name] = found
            else:
                answers[name] = found
                write_answers(output, answers)
            bar.advance(task)
    for name, why in sorted(failures.items()):
        typer.echo(f"no answer to {printable(name)}: {printable(why)}")
    if not answers:
        raise InputError(f"{folder}: none of its {len(failures)} sets could be answered")
    typer.echo(f"{len(answers)} answers written to {output}")


SCORE_EXAMPLES = """
Examples:

\b
  drft blind score out/blind --answers out/answers.json -o out/score.json
  drft blind score out/first out/second --answers out/first.json \\
      --answers out/second.json
"""


@app.command(epilog=SCORE_EXAMPLES)
def score(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of sets, with their labels.", show_default=False)
    ],
    answers: Annotated[
        list[Path],
        typer.Option(help="The answers to them (JSON); for several folders, one for each."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the score here (JSON).")
    ] = None,
) -> None:
    """Open the labels of folders of sets and hold answers against them, all together."""

    from rich.console import Console

    from diagnose.blind.scoring.score import open_and_score
    from diagnose.blind.scoring.score import score as scored
    from diagnose.blind.scoring.table import tables
    from drftjax.common.output_files import replace_file, require_places
    from drftjax.common.structured_files import as_json

    if output is not None:
        require_places([output], answers)
    found = scored(*open_and_score(folders, answers))
    console = Console()
    for table in tables(found):
        console.print(table)
    if missing := found["unanswered"]:
        more = f" and {len(missing) - MOST_NAMES} more" if len(missing) > MOST_NAMES else ""
        typer.echo(f"without an answer: {', '.join(missing[:MOST_NAMES])}{more}")
    if output is not None:
        replace_file(output, as_json(found))
        typer.echo(f"score written to {output}")


if __name__ == "__main__":
    app()
