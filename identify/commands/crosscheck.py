"""`drft crosscheck`: the paper's online tuner beside the offline zeta(t) of recorded runs."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import PlotFile, draw_picture, remove_empty_folders, require_picture
from drftjax.commands.printing import say_on
from drftjax.common.output_files import files_of, stem_of
from identify.crosscheck.report import tables

if TYPE_CHECKING:
    from drftjax.results.provenance import Provenance
    from identify.crosscheck.crosscheck import CrossCheck

app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft crosscheck data/runs/medium.h5
  drft crosscheck runs/*.h5 --tick 0.005 --zeta-step 0.002 \\
      -o out/crosscheck

The result is out/crosscheck.json and out/crosscheck.png.
"""


@app.command(epilog=EXAMPLES)
@remove_empty_folders
def crosscheck(
    runs: Annotated[
        list[Path], typer.Argument(help="Run logs, or folders of them.", show_default=False)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Stem of the result files.")
    ] = None,
    tick: Annotated[float, typer.Option(help="Control period of the tuner [s].")] = 0.01,
    zeta_step: Annotated[float, typer.Option(help="Change of zeta on one tick.")] = 0.001,
    tolerance: Annotated[
        float, typer.Option(help="Error of the sinkage that is left alone [m].")
    ] = 1e-4,
    picture: PlotFile = None,
    knots: Annotated[float, typer.Option(help="Knot spacing of the offline zeta(t) [s].")] = 1.0,
    sweep: Annotated[bool, typer.Option(help="Try other ticks, steps and tolerances too.")] = True,
) -> None:
    """Replay the online tuner over recorded runs and compare it with their offline zeta(t)."""
    from rich.console import Console

    from drftjax.common.jax_config import configure_jax

    configure_jax()
    import dataclasses

    from drftjax.commands.progress import progress_line
    from drftjax.common.output_files import require_places
    from drftjax.recorded.gather import gather
    from drftjax.recorded.prepared_run import PreparedRun, prepare_run
    from drftjax.results.provenance import command_provenance
    from drftjax.runlog.record import RunLog
    from drftjax.tuning.step_tuner import StepTuner
    from identify.crosscheck.crosscheck import crosscheck as check
    from identify.crosscheck.replays import TunerSetting

    require_picture(picture, runs)
    StepTuner(tick, zeta_step, tolerance)  # refuses what cannot be before any file is read
    if output is not None:
        require_places(result_files(output), runs)
    made = command_provenance("crosscheck", runs)
    console = Console()
    online = {}

    def ready(name: str, run: RunLog) -> PreparedRun:
        if run.online is not None:
            online[name] = run.online
        return prepare_run(name, run)

    say = partial(say_on, console, style="yellow")

    with progress_line(console, "reading runs") as show:
        gathered = gather(runs, ready, sinkage=True, tell=say)
        prepared = gathered.runs
        show(f"replaying and fitting {len(prepared)} runs")
        setting = TunerSetting(tick, zeta_step, tolerance)
        result = check(prepared, setting, online=online, knot_spacing=knots, sweep=sweep)
        for name, why in result.failures.items():
            say(f"left out: {name}: {why}")
        result = dataclasses.replace(result, failures=gathered.skipped | dict(result.failures))

    for table in tables(result):
        console.print(table)
    for run in result.runs:
        if not run.offline.converged:
            say(f"{run.name}: the offline zeta(t) has not settled")
        if said := run.offline.contradiction():
            said += "; `drft diagnose` looks for the cause"
            say(said)
    if output is not None:
        written = write(result, output, made)
        say_on(console, f"written: {', '.join(str(each) for each in written)}")
    if picture is not None:
        from identify.crosscheck.figure import plot_crosscheck

        draw_picture(plot_crosscheck(result), picture)


def result_files(output: Path) -> list[Path]:
    """The numbers and the figure, by the stem that was asked for."""
    endings = (".json", ".png")
    return files_of(stem_of(output, endings), endings)


def write(result: "CrossCheck", stem: Path, provenance: "Provenance") -> list[Path]:
    """Write `stem`.json, with the provenance, and `stem`.png.

    Raises:
        InputError: where they cannot be written.
    """
    from drftjax.common.figures import save_figure
    from drftjax.common.output_files import make_folder, replace_file
    from drftjax.common.structured_files import as_json
    from identify.crosscheck.figure import plot_crosscheck

    text, picture = result_files(stem)
    make_folder(stem.parent)
    replace_file(text, as_json({**result.document(), "provenance": provenance.document()}))
    save_figure(plot_crosscheck(result), picture)
    return [text, picture]
