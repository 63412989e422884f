"""`drft hils paper`: the paper's experiment again, on a virtual rig whose sand loosens."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.options import remove_empty_folders
from drftjax.commands.printing import say

EXAMPLES = """
Examples:

  drft hils paper -o out/

  drft hils paper --runs 2 --no-ticks -o out/

  drft hils paper --rig rig.toml --tick 0.005 -o out/

Written are paper.json, paper.md (its tables), fig7.png, fig8.png and ripple.png;
docs/results/hils-paper.md
tells what they show. Ten runs of either kind take a minute or two, in virtual time.
"""


@remove_empty_folders
def paper(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the results.")] = Path(
        "out"
    ),
    runs: Annotated[
        int, typer.Option(help="HILS runs, and as many free runs.", min=1, max=1000)
    ] = 10,
    tick: Annotated[float, typer.Option(help="Control period [s].")] = 0.01,
    seed: Annotated[
        int, typer.Option(help="Of the first run's noise and bed.", min=0, max=2**32 - 1)
    ] = 0,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="Set-up of the virtual rig (TOML).", show_default="the paper's, its sand loosens"
        ),
    ] = None,
    profile: Annotated[
        Path | None,
        typer.Option(help="Set-up and profile of the loop.", show_default="data/paper.toml"),
    ] = None,
    ticks: Annotated[bool, typer.Option(help="One run at each of some other ticks too.")] = True,
) -> None:
    """Make the paper's experiment again: HILS runs beside free runs on sand that loosens."""
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    from hils.realtime import answer_at_once

    answer_at_once()
    from rich.console import Console

    from drftjax.commands.progress import progress_line
    from drftjax.common.figures import save_figure
    from drftjax.common.output_files import make_folder, replace_file
    from drftjax.common.packages import data_file
    from drftjax.common.structured_files import as_json
    from drftjax.setups.setup import read_setup
    from hils.control.limits import CommandLimits
    from hils.control.loop_config import LoopSetUp
    from hils.control.loop_config import profile as profile_of
    from hils.experiment.experiment import Experiment, loosening_rig, run_experiment, runs_by_tick
    from hils.experiment.figures import ripple_figure, runs_figure, trajectory_figure
    from hils.experiment.report import markdown_report
    from hils.rig_sim.config import read_virtual_setup

    experiment = Experiment(
        loop=LoopSetUp(
            setup=read_setup(profile or data_file("paper.toml")),
            commands=CommandLimits(2.0, 0.3),
            tick=tick,
        ),
        rig=loosening_rig() if rig is None else read_virtual_setup(rig),
        runs=runs,
        seed=seed,
    )
    profile_of(experiment.loop, 1)
    make_folder(output)
    console = Console()
    with progress_line(console, "compiling") as show:
        result = run_experiment(experiment, show)
        others = runs_by_tick(experiment, report_progress=show) if ticks else {}

    text = markdown_report(result, others)
    document = result.document() | {
        "by_tick": [
            {"tick": each, "rmse_z_mm": made.rmse * 1e3, "zeta_end": float(made.zeta[-1])}
            for each, made in others.items()
        ]
    }
    figures = {
        "fig7.png": runs_figure(result),
        "fig8.png": trajectory_figure(result),
        "ripple.png": ripple_figure(result),
    }
    replace_file(output / "paper.json", as_json(document))
    replace_file(output / "paper.md", text.encode())
    for name, figure in figures.items():
        save_figure(figure, output / name)
    typer.echo(text)
    written = ", ".join(str(output / name) for name in ("paper.json", "paper.md", *figures))
    say(f"written: {written}")
