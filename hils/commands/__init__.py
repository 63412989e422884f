"""`drft hils`: run a rig in the loop, over a serial port or virtually. One module a subcommand."""

import typer

from hils.commands.rig import EXAMPLES as RIG_EXAMPLES
from hils.commands.rig import rig

app = typer.Typer(
    name="hils",
    help="Run a single-wheel rig in the loop over a serial port, or a virtual one.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command(epilog=RIG_EXAMPLES)(rig)


@app.callback()
def hils() -> None:
    """Run a single-wheel rig in the loop over a serial port, or a virtual one."""
