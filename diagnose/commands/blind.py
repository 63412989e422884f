"""`drft blind`: make sets of runs with random hidden faults, answer them, score the answers."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import CommandGroup
from drftjax.commands.printing import say, say_next
from drftjax.commands.progress import progress_line
from drftjax.common.errors import InputError

app = typer.Typer(
    cls=CommandGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None
)


# Most sets without an answer that are listed by name.
MAX_NAMES_SHOWN = 10


@app.callback()
def blind() -> None:
    """Test diagnoses on sets of runs whose faults are random and sealed."""


MAKE_EXAMPLES = """
Examples:

  drft blind make out/blind --sets 300 --seed 7 --jobs 2

  drft blind make out/strong --sets 40 --protocol practice --faintest 10

  drft blind make out/pairs --sets 24 --wrong pair --faintest 3

  drft blind make out/sweeps --sets 24 --kind sweep
"""


@app.command(epilog=MAKE_EXAMPLES)
def make(
    folder: Annotated[Path, typer.Argument(help="A new folder for the sets.")],
    sets: Annotated[int, typer.Option(help="Number of sets, 100000 at most.")] = 100,
    seed: Annotated[
        int, typer.Option(help="Seed of every random choice.", min=0, max=2**32 - 1)
    ] = 0,
    protocol: Annotated[
        str,
        typer.Option(
            help="'practice', 'random', or 'mixed': each set one or the other. 'telling': the rigs "
            "of 'mixed', on the runs of `drft protocol`."
        ),
    ] = "mixed",
    faintest: Annotated[float, typer.Option(help="Least gap of an effect [noise floors].")] = 0.5,
    strongest: Annotated[float, typer.Option(help="Greatest gap [noise floors].")] = 30.0,
    wrong: Annotated[
        str,
        typer.Option(
            help="What is wrong with every set: 'none', 'one', 'pair' or 'unknown' (an effect "
            "outside the catalogue); 'mixed': some of each. Changes and sweeps know 'none' "
            "and 'one'."
        ),
    ] = "mixed",
    kind: Annotated[
        str,
        typer.Option(
            help="'single': one effect, two or none. 'several': three or four. 'change': five runs "
            "before and five now, between which one thing changes. 'sweep': a driven carriage at "
            "slips from 0 to 0.6, with forces and torque."
        ),
    ] = "single",
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Make sets of runs of rigs with a hidden fault, or none, and seal their labels."""
    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from diagnose.blind.generation.generate import make_sets
    from diagnose.blind.generation.settings import GenerationRequest

    request = GenerationRequest(folder, sets, seed, protocol, faintest, strongest, wrong, kind)
    with progress_line(Console(), "making sets", total=sets) as show:
        for number, _ in enumerate(make_sets(request, jobs), start=1):
            show("making sets", number)
    say(f"{sets} sets written to {folder}; their labels are sealed")
    say_next("blind", "answer", folder, "-o", f"{folder}_answers.json")


ANSWER_EXAMPLES = """
Examples:

  drft blind answer out/blind -o out/answers.json --jobs 2

  drft blind answer out/blind -o out/answers.json --cluster local:2

Each answer is written as soon as it is found; with --resume, answers in the file are kept and only
the other sets are diagnosed. With --cluster, answers go into a file .store beside, and a set whose
runs were answered before is not diagnosed again. Labels are never opened: the command works without
them, too.
"""


@app.command(epilog=ANSWER_EXAMPLES)
def answer(
    folder: Annotated[Path, typer.Argument(help="A folder of sets.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Write the answers here (JSON).")],
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    resume: Annotated[bool, typer.Option("--resume", help="Keep the answers in the file.")] = False,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Diagnose on a Dask cluster, 'local', 'local:N' or 'tcp://scheduler:port', and go "
            "on where a killed call ended."
        ),
    ] = None,
) -> None:
    """Diagnose every set of a folder from its runs alone."""
    from diagnose.blind.answers.answer import runs_of
    from diagnose.blind.answers.answer_file import read_raw_answers, write_answers
    from drftjax.common.output_files import require_places
    from drftjax.common.text import replace_unprintable

    if output.suffix.lower() != ".json":
        raise InputError(f"{output}: a file of answers must end in .json")
    if cluster is not None and (jobs != 1 or resume):
        raise InputError(
            "--cluster has workers and a store of its own; leave --jobs and --resume out"
        )
    answers = read_raw_answers(output) if resume and output.exists() else {}
    open_sets = {name: runs for name, runs in runs_of(folder).items() if name not in answers}
    require_places([output])
    if cluster is None:
        failures = _answer_here(open_sets, jobs, output, answers)
    else:
        failures = _answer_on_cluster(cluster, open_sets, output, answers)
    for name, reason in sorted(failures.items()):
        say(f"no answer to {replace_unprintable(name)}: {replace_unprintable(reason)}")
    if not answers:
        raise InputError(f"{folder}: none of its {len(failures)} sets could be answered")
    if cluster is not None:
        write_answers(output, answers)
    say(f"{len(answers)} answers written to {output}")
    say_next("blind", "score", folder, "--answers", output)


def _answer_here(
    sets: dict[str, list[Path]], jobs: int, output: Path, answers: dict[str, dict]
) -> dict[str, str]:
    """Add answers found by processes of this machine; return why there is none, by set."""
    from rich.console import Console

    from diagnose.blind.answers.answer import answer_sets, configure
    from diagnose.blind.answers.answer_file import write_answers

    configure()
    failures: dict[str, str] = {}
    with progress_line(Console(), "answering", total=len(sets)) as show:
        for number, (name, result) in enumerate(answer_sets(sets, jobs), start=1):
            if isinstance(result, str):
                failures[name] = result
            else:
                answers[name] = result
                write_answers(output, answers)
            show("answering", number)
    return failures


def _answer_on_cluster(
    address: str, sets: dict[str, list[Path]], output: Path, answers: dict[str, dict]
) -> dict[str, str]:
    """Add answers found on a cluster or kept in its store; return why there is none, by set."""
    from rich.console import Console

    from drftjax.cluster.connection import (
        connect,
        dashboard,
        parse_address,
        quiet_dask,
        require_extra,
    )
    from drftjax.cluster.store import WorkStore

    where = parse_address(address)
    require_extra()
    quiet_dask()
    from diagnose.blind.answers.answer import folder_of
    from diagnose.blind.answers.answer_on_cluster import (
        ANSWER_STORE,
        AnswerOptions,
        SetFiles,
        answer_on,
        stored_answer,
    )

    failures: dict[str, str] = {}
    files: dict[str, SetFiles] = {}
    for name, runs in sets.items():
        try:
            files[name] = SetFiles.at(folder_of(runs))
        except InputError as problem:
            failures[name] = str(problem)
    options = {"software": AnswerOptions().software}
    with WorkStore(output.with_suffix(".store"), ANSWER_STORE, options) as store:
        todo = {name: each for name, each in files.items() if each.digest not in store}
        if len(todo) < len(files):
            say(f"{store.path} has {len(files) - len(todo)} of these {len(sets)} sets")
        why: dict[str, str] = {}
        if todo:
            with connect(where) as client:
                say(f"dashboard: {dashboard(client)}")
                with progress_line(Console(), "waiting for workers", total=len(todo)) as show:

                    def report(dealt_with: int, workers: int) -> None:
                        show(f"answering on {workers} workers", dealt_with)

                    why = answer_on(client, todo, store, report)
        for name, each in files.items():
            if each.digest in store:
                answers[name] = stored_answer(store, each.digest)
            else:
                failures[name] = why[each.digest]
    return failures


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
        typer.Option(help="File of answers (JSON); one for each folder, in the same order."),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write the score here (JSON).")
    ] = None,
) -> None:
    """Open the labels of folders of sets and score answers against them, all together."""

    from rich.console import Console

    from diagnose.blind.scoring.score import read_labels_and_answers, score_answers
    from diagnose.blind.scoring.table import tables
    from drftjax.common.output_files import replace_file, require_places
    from drftjax.common.structured_files import as_json

    if output is not None:
        require_places([output], answers)
    scores = score_answers(*read_labels_and_answers(folders, answers))
    console = Console()
    for table in tables(scores):
        console.print(table)
    if missing := scores["unanswered"]:
        shown, others = missing[:MAX_NAMES_SHOWN], len(missing) - MAX_NAMES_SHOWN
        more = f" and {others} more" if others > 0 else ""
        say(f"without an answer: {', '.join(shown)}{more}")
    if output is not None:
        replace_file(output, as_json(scores))
        say(f"score written to {output}")


if __name__ == "__main__":
    app()
