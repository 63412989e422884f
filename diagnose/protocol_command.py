"""`drft protocol`: nine runs that tell effects apart, as set-up files for a rig."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.errors import InputError

app = typer.Typer(add_completion=False, rich_markup_mode=None)

EXAMPLES = """
Examples:

\b
  drft protocol data/paper.toml -o out/protocol
  drft protocol --like run.h5 --max-travel 1.2 --max-speed 120 -o out/protocol
  drft hils run --port /dev/ttyUSB0 --mode free --profile out/protocol/3_backward.toml \\
      -o runs/backward.h5

Record them with the carriage free, then: drft diagnose runs/
"""


@app.command(epilog=EXAMPLES)
def protocol(
    output: Annotated[Path, typer.Option("-o", "--output", help="A new folder for the set-ups.")],
    setup: Annotated[
        Path | None, typer.Argument(help="A set-up file (TOML or JSON).", show_default=False)
    ] = None,
    like: Annotated[Path | None, typer.Option(help="A run log instead: its set-up.")] = None,
    max_speed: Annotated[
        float | None, typer.Option(help="Largest speed of the wheel [deg/s].")
    ] = None,
    max_travel: Annotated[
        float | None, typer.Option(help="Longest way of the carriage [m].")
    ] = None,
) -> None:
    """Write nine runs to record for a diagnosis: the ones that tell effects apart."""
    if (setup is None) == (like is None):
        raise InputError("name one set-up file, or --like RUN, and not both")
    from rich.console import Console
    from rich.table import Table

    from diagnose.protocol import telling_runs
    from drftjax.commands.runtime import configure_jax
    from drftjax.like import setup_like
    from drftjax.runlog.replace import make_folder, replace_file
    from drftjax.setup import read_setup
    from drftjax.setup_toml import setup_toml

    configure_jax()
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise InputError(f"{output} is not an empty folder; name a new one")
    if setup is not None:
        rig = read_setup(setup)
    else:
        assert like is not None
        rig, _ = setup_like(like)
    runs = list(telling_runs(rig, max_speed, max_travel))
    make_folder(output)
    table = Table("set-up", "load [kg]", "speed [deg/s]", "lasts [s]", "tells")
    for number, (run, each) in enumerate(runs, start=1):
        name = f"{number}_{run.name}.toml"
        replace_file(output / name, setup_toml(each, [f"Tells {run.tells}."]).encode())
        speed = max(each.command.omega, key=abs)
        lasts = f"{each.command.time[-1]:.1f}"
        table.add_row(name, f"{each.rig.mass_z:.1f}", f"{speed:.0f}", lasts, run.tells)
    Console().print(table)
    typer.echo(f"nine set-ups written to {output}")
