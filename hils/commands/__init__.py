"""`drft hils`: run a rig in the loop, over a serial port or virtually. One module a subcommand."""

import typer

app = typer.Typer(
    name="hils",
    help="Run a single-wheel rig in the loop over a serial port, or a virtual one.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
