"""`drft hils stop`: bring the rig to rest from another terminal."""

from typing import Annotated

import typer

EXAMPLES = """
Examples:

  drft hils stop

  drft hils stop --now

Without --now the wheel is ramped down, with it the rig makes an emergency stop. Either way the
file is closed. Keep the rig's own emergency stop in reach all the same.
"""


def stop(
    port: Annotated[
        str | None, typer.Option(help="Only the run on this port.", show_default="every run")
    ] = None,
    now: Annotated[bool, typer.Option("--now", help="Emergency stop, without a ramp.")] = False,
) -> None:
    """Stop the runs that are under way on this computer."""
    from hils.procedure.stop_runs import stop_runs

    stop_runs(port, now)
