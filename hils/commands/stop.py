"""`drft hils stop`: bring the rig to rest from another terminal."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.common.errors import InputError

EXAMPLES = """
Examples:

  drft hils stop

  drft hils stop --now

Without --now the wheel is ramped down, with it the rig makes an emergency stop. Either way the
file is closed. Keep the rig's own emergency stop in reach all the same.
"""


# A ramp on a loaded computer; closing the file may take its own time after that [s].
LONGEST_RAMP = 60.0


def stop(
    port: Annotated[
        str | None, typer.Option(help="Only the run on this port.", show_default="every run")
    ] = None,
    now: Annotated[bool, typer.Option("--now", help="Emergency stop, without a ramp.")] = False,
) -> None:
    """Stop the runs that are under way on this computer."""
    from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
    from hils.procedure.active_runs import runs_under_way, send_signal, wait_until_ended
    from hils.recording.recorder import CLOSE_LIMIT

    every = runs_under_way()
    runs = [run for run in every if port is None or run.port == port]
    if not runs:
        others = ", ".join(run.port for run in every)
        raise InputError(
            f"no run is under way on {port}, but on {others}"
            if others
            else "no run of this user's is under way on this computer"
        )
    for run in runs:  # all of them first, then wait
        send_signal(run, EMERGENCY_SIGNAL if now else STOP_SIGNAL)
    for run in runs:
        if not wait_until_ended(run, LONGEST_RAMP):
            typer.echo(
                f"the run on {run.port} has not ended in {LONGEST_RAMP:g} s; its file may be being "
                "closed. Where the rig does not rest, use its emergency stop",
                err=True,
            )
            if not wait_until_ended(run, CLOSE_LIMIT):
                raise InputError(
                    f"the run on {run.port} (process {run.pid}) has not ended in "
                    f"{LONGEST_RAMP + CLOSE_LIMIT:g} s; use the rig's emergency stop"
                )
        # A run that is stopped before its first tick leaves none.
        file = f"; its file is {run.output}" if Path(run.output).exists() else ""
        typer.echo(f"the run on {run.port} has ended{file}")
