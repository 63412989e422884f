"""`drft evaluate`: compare a diagnosis's model with runs that it was not fitted to."""

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import (
    PlotFile,
    draw_picture,
    refuse_options,
    remove_empty_folders,
    require_picture,
)
from drftjax.commands.printing import say_on
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from diagnose.evaluation.result import Evaluation
    from diagnose.evaluation.tuner_activity import TunerActivity
    from drftjax.common.rich_text import WholeWordTable

app = typer.Typer(add_completion=False, rich_markup_mode=None)


SCHEMA = "drft-evaluation"


EXAMPLES = """
Examples:

\b
  drft evaluate fresh/*.h5 --model out/diagnosis/model.toml
  drft evaluate fresh/ --model out/diagnosis/model.toml --tuner \\
      --json out/evaluation.json

A run that was made in the loop is replayed by --tuner in that very loop; --tick, --zeta-step and
--tolerance are for the others.

Each run is simulated freely from its start, by the reference model and by that with the effects
of the model file, each with the zeta that matches the run's mean sinkage. All other numbers are the
run's own.
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def evaluate(
    context: typer.Context,
    runs: Annotated[
        list[Path], typer.Argument(help="Run logs, or folders of them.", show_default=False)
    ],
    model: Annotated[
        Path,
        typer.Option(help="A set-up file with [[effect]]s: model.toml of a diagnosis."),
    ],
    output: Annotated[
        Path | None, typer.Option("--json", help="Write the numbers here (JSON).")
    ] = None,
    picture: PlotFile = None,
    tuner: Annotated[
        bool, typer.Option("--tuner", help="Replay the online tuner of eq. 7 with each model too.")
    ] = False,
    tick: Annotated[float, typer.Option(help="Control period of the tuner [s].")] = 0.01,
    zeta_step: Annotated[float, typer.Option(help="Change of zeta on one tick.")] = 0.001,
    tolerance: Annotated[
        float, typer.Option(help="Error of the sinkage that is left alone [m].")
    ] = 1e-4,
) -> None:
    """Hold a model with effects against runs, beside the reference model."""
    if not tuner:
        refuse_options(context, ("tick", "zeta_step", "tolerance"), "give --tuner too")
    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from diagnose.dataset import RigDataset
    from diagnose.evaluation.evaluate import evaluate_model
    from diagnose.evaluation.model_reader import read_model_file
    from diagnose.evaluation.result import gap_table, sentences
    from diagnose.evaluation.tuner_activity import tuner_activity
    from diagnose.gap.gap import INTERVAL_SEED
    from diagnose.rig_runs import gather_runs
    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import replace_file, require_places
    from drftjax.common.structured_files import as_json
    from drftjax.results.provenance import command_provenance
    from drftjax.tuning.step_tuner import StepTuner

    setting = StepTuner(tick, zeta_step, tolerance)
    require_picture(picture, [*runs, model])
    added = read_model_file(model)
    if output is not None:
        if output.suffix.lower() != ".json":
            raise InputError(f"{output}: the file of --json must end in .json")
        require_places([output], [model])
    made = command_provenance("evaluate", [*runs, model], INTERVAL_SEED)
    console = Console()
    say = partial(say_on, console)

    moved: list[tuple[TunerActivity, TunerActivity]] = []
    with progress_line(console, "reading runs") as show:
        gathered = gather_runs(runs, origin=added.origin)
        show(f"simulating {len(gathered.runs)} runs with both models")
        caveats = added.caveats(gathered.runs)
        found = evaluate_model(
            RigDataset.of(gathered.runs), added.effects, gathered.skipped, caveats
        )
        if tuner:
            show("replaying the tuner")
            moved = tuner_activity(found.dataset, found.effects, found.zeta, setting)

    console.print(gap_table(found))
    if moved:
        console.print(moves_table(found, moved))
    for sentence in [*_replayed(found, moved), *sentences(found)]:
        say(sentence)
    if output is not None:
        head = {"schema": SCHEMA, "schema_version": 1, "model": str(model)}
        document = {**head, "provenance": made.document(), **found.document()}
        if moved:
            document["tuner"] = moves_document(found, moved, setting)
        replace_file(output, as_json(document))
        say(f"written: {output}")
    if picture is not None:
        draw_picture(found.plot(), picture)


def moves_table(
    found: "Evaluation", moved: "list[tuple[TunerActivity, TunerActivity]]"
) -> "WholeWordTable":
    """Table of the changes of zeta by the tuner, without and with the effects."""
    from rich.markup import escape

    from drftjax.common.rich_text import WholeWordTable

    table = WholeWordTable(title="online tuner", title_justify="left")
    for name in ("run", "sum of |dzeta|", "range of zeta", "sinkage left \\[mm]"):
        table.add_column(name, justify="left" if name == "run" else "right")
    for each, (before, after) in zip(found.dataset.runs, moved, strict=True):
        table.add_row(
            escape(each.name),
            f"{before.moved:.3f} → {after.moved:.3f}",
            f"{before.range:.3f} → {after.range:.3f}",
            "-"
            if math.isnan(before.sinkage)
            else f"{1e3 * before.sinkage:.3f} → {1e3 * after.sinkage:.3f}",
        )
    table.add_section()
    first, last = (sum(pair[which].moved for pair in moved) for which in (0, 1))
    table.add_row("all runs", f"{first:.3f} → {last:.3f}", _less(first, last))
    return table


def _replayed(found: "Evaluation", moved: "list[tuple[TunerActivity, TunerActivity]]") -> list[str]:
    """Sentences on the runs that were replayed in their own loop, or not at all."""
    pairs = zip(found.dataset.runs, moved, strict=False)
    names = [each.name for each, (before, _) in pairs if before.in_its_loop]
    never = [
        f"{each.name}: no reading could be tuned by while the wheel moved, so zeta was held."
        for each, (before, _) in zip(found.dataset.runs, moved, strict=False)
        if math.isnan(before.sinkage)
    ]
    if not names:
        return never
    loop = "in the loop that it was" if len(names) == 1 else "each in the loop that it was"
    return [f"By --tuner, {', '.join(names)} replayed {loop} made in.", *never]


def _less(before: float, after: float) -> str:
    if before == 0:
        return "-"
    return f"{abs(1 - after / before):.0%} {'less' if after <= before else 'more'} to move"


def moves_document(
    found: "Evaluation", moved: "list[tuple[TunerActivity, TunerActivity]]", setting
) -> dict:
    """Changes of zeta by the tuner as plain values, in the layout of the JSON file."""
    return {
        "tick": float(setting.tick),
        "zeta_step": float(setting.zeta_step),
        "tolerance": float(setting.tolerance),
        "runs": [
            {
                "name": each.name,
                "in_its_loop": before.in_its_loop,
                "before": _numbers(before),
                "after": _numbers(after),
            }
            for each, (before, after) in zip(found.dataset.runs, moved, strict=True)
        ],
    }


def _numbers(each: "TunerActivity") -> dict[str, float]:
    return {"moved": each.moved, "range": each.range, "sinkage_mm": 1e3 * each.sinkage}


if __name__ == "__main__":
    app()
