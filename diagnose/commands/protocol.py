"""`drft protocol`: nine runs that tell effects apart, as set-up files for a rig."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drftjax.commands.options import USUAL_OMEGA_MAX
from drftjax.commands.printing import say, say_next
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from drftjax.setups.setup import SetUp

# A run that limits slow down below this share of its speed shows little of what it is for [-].
MIN_SPEED_SHARE = 0.5


app = typer.Typer(add_completion=False, rich_markup_mode=None)


EXAMPLES = """
Examples:

\b
  drft protocol data/paper.toml -o out/protocol
  drft protocol --like run.h5 --max-travel 1.2 --max-speed 120 -o out/protocol
  drft hils run --port /dev/ttyUSB0 --mode free \\
      --profile out/protocol/3_backward.toml -o runs/backward.h5
  drft hils run --port /dev/ttyUSB0 --mode free --omega-max 3.5 \\
      --profile out/protocol/8_fast_light.toml -o runs/fast_light.h5

Record them with the carriage free, then: drft diagnose runs/

Record all nine while the rig is healthy, and all again later (two are of one command, which tells
how much the sand scatters), then: drft diagnose now/ --against before/
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
        float | None, typer.Option(help="Largest travel of the carriage [m].")
    ] = None,
) -> None:
    """Write nine runs to record for a diagnosis: the ones that tell effects apart."""
    if (setup is None) == (like is None):
        both = "" if setup is None else ", not both"
        raise InputError(f"name one set-up file, or --like RUN{both}")
    from rich.console import Console
    from rich.markup import escape

    from diagnose.next_runs.recommended_runs import recommended_runs
    from drftjax.common.jax_config import configure_jax
    from drftjax.common.output_files import make_folder, replace_file
    from drftjax.common.rich_text import WholeWordTable
    from drftjax.setups.setup_toml import setup_toml

    configure_jax()
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise InputError(f"{output} is not an empty folder; name a new one")
    rig = _rig(setup, like)
    runs = list(recommended_runs(rig, max_speed, max_travel))
    make_folder(output)
    fast = {}
    table = WholeWordTable("set-up")
    for heading in ("load [kg]", "speed [deg/s]", "lasts [s]", "tells"):
        table.add_column(escape(heading))
    for number, (run, each) in enumerate(runs, start=1):
        name = f"{number}_{run.name}.toml"
        speed, wanted = max(each.command.omega, key=abs), max(run.speed, key=abs)
        tells = run.tells
        if abs(speed) < MIN_SPEED_SHARE * abs(wanted):
            tells = f"little, slowed down from {abs(wanted):.0f} deg/s: {tells}"
        replace_file(output / name, setup_toml(each, [f"Tells {tells}."]).encode())
        omega = math.radians(abs(speed))
        if omega > USUAL_OMEGA_MAX:
            fast[name] = omega
        lasts = f"{each.command.time[-1]:.1f}"
        table.add_row(name, f"{each.rig.mass_z:.1f}", f"{speed:.0f}", lasts, tells)
    Console().print(table)
    say(f"nine set-ups written to {output}")
    if fast:
        say(_allowance(fast))
    first = output / f"1_{runs[0][0].name}.toml"
    recorded = ("--mode", "free", "--profile", first, "-o", f"runs/{runs[0][0].name}.h5")
    say_next("hils", "run", "--port", "PORT", *recorded)


def _rig(setup: Path | None, like: Path | None) -> "SetUp":
    """The rig with its carriage free, also where it was driven in the recorded run.

    Raises:
        InputError: names the file, what it lacks and what must hold.
    """
    from drftjax.setups.from_run import setup_like
    from drftjax.setups.setup import read_setup

    if setup is not None:
        rig = read_setup(setup)
        if rig.rig.carriage != "free":
            raise InputError(
                f"{setup}: the carriage of [rig] is driven; these runs are of one that is free: "
                "leave out carriage, and vx in [command], if the rig can let it go"
            )
        return rig
    assert like is not None
    rig, run = setup_like(like)
    if rig.rig.carriage != "free":
        if run.setup.mass_x is None:
            raise InputError(
                f"{like}: its carriage is driven and its /setup lacks mass_x, without which one "
                "that is free cannot be simulated; name a set-up file with mass_x in [rig] instead"
            )
        rig.rig.carriage, rig.command.vx = "free", None
        say(f"note: the carriage of {like} was driven; in these runs it is to be free")
    return rig


def _allowance(fast: dict[str, float]) -> str:
    """Sentence on the options for runs that are faster than `drft hils run` allows by default.

    Args:
        fast: Largest angular velocity by set-up [rad/s].
    """
    needed = math.ceil(round(10 * max(fast.values()), 6)) / 10
    slower = math.floor(math.degrees(USUAL_OMEGA_MAX))
    return (
        f"{' and '.join(fast)} need drft hils run --omega-max {needed:g}, and a rig that allows as "
        f"much (a virtual one: omega_max = {needed:g} in [limits] of its --setup); with "
        f"--max-speed {slower} no run does"
    )
