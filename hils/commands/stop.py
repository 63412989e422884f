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


def stop(
    port: Annotated[
        str | None, typer.Option(help="Only the run on this port.", show_default="every run")
    ] = None,
    now: Annotated[bool, typer.Option("--now", help="Emergency stop, without a ramp.")] = False,
) -> None:
    """Stop the runs that are under way on this computer."""
    from hils.recording.recorder import DEFAULT_RECORDER

    stop_runs(port, now, longest_close=DEFAULT_RECORDER.close_time)


def stop_runs(
    port: str | None, now: bool, longest_close: float, longest_ramp: float = 60.0
) -> None:
    """Stop runs, and wait until they have ended.

    Args:
        port: Port of the run; None for every run.
        now: True for an emergency stop.
        longest_close: Time in which a run's file is closed [s].
        longest_ramp: Time in which a rig comes to rest, on a loaded computer [s].

    Raises:
        InputError: there is no such run, or one has not ended after both times.
    """
    from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
    from hils.procedure.active_runs import runs_under_way, send_signal, wait_until_ended

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
        if not wait_until_ended(run, longest_ramp):
            typer.echo(
                f"the run on {run.port} has not ended in {longest_ramp:g} s; its file may be being "
                "closed. Where the rig does not rest, use its emergency stop",
                err=True,
            )
            if not wait_until_ended(run, longest_close):
                raise InputError(
                    f"the run on {run.port} (process {run.pid}) has not ended in "
                    f"{longest_ramp + longest_close:g} s; use the rig's emergency stop"
                )
        # A run that is stopped before its first tick leaves none.
        file = f"; its file is {run.output}" if Path(run.output).exists() else ""
        typer.echo(f"the run on {run.port} has ended{file}")
