"""`drft bench`: the speed of simulated runs on this machine, beside plain NumPy and C++."""

import os
from pathlib import Path
from typing import Annotated

import typer

from drftjax.common.errors import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None)

EXAMPLES = """
Examples:

  drft bench

  drft bench --runs 4096 --cpp ../shared/yardstick/drft.cpp
"""


@app.command(epilog=EXAMPLES)
def bench(
    runs: Annotated[int, typer.Option(help="Runs of the ensemble, 2 to 100000.")] = 256,
    repeats: Annotated[
        int, typer.Option(help="Times that each is measured; the least counts.")
    ] = 3,
    cpp: Annotated[
        Path | None,
        typer.Option(
            help="A C++ program of the same model, built by g++ and run: called with the number of "
            "runs, the step and the duration [s], it prints 'steps N: S s, U us'."
        ),
    ] = None,
) -> None:
    """Measure how fast runs of the paper's profile are simulated on this machine."""
    if not 2 <= runs <= 100_000:
        raise InputError(f"--runs is {runs}, must be 2 to 100000")
    if not 1 <= repeats <= 100:
        raise InputError(f"--repeats is {repeats}, must be 1 to 100")
    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=os.cpu_count())
    from rich.console import Console

    from drftjax.simulation.speed import measure, table

    Console(highlight=False).print(table(measure(runs, repeats, cpp)))
