"""Stop of the runs under way: the signals first, then a wait for their ends.

Up to the signals it imports nothing but Python's own library and a few small modules: each package
more is time in which the wheel goes on.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from drftjax.common.errors import InputError
from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
from hils.procedure import active_runs

REFUSED, INTERRUPTED = 2, 128 + 2  # exit codes, as `drftjax.commands.main` has them


def stop_runs(
    port: str | None, now: bool, longest_close: float | None = None, longest_ramp: float = 60.0
) -> None:
    """Stop runs, and wait until they have ended.

    Args:
        port: Port of the run; None for every run.
        now: True for an emergency stop.
        longest_close: Time in which a run's file is closed [s]; None for the recorder's own.
        longest_ramp: Time in which a rig comes to rest, on a loaded computer [s].

    Raises:
        InputError: there is no such run, or one has not ended after both times.
    """
    every = active_runs.runs_under_way()
    runs = [run for run in every if port is None or run.port == port]
    if not runs:
        others = ", ".join(run.port for run in every)
        raise InputError(
            f"no run is under way on {port}, but on {others}"
            if others
            else "no run of this user's is under way on this computer"
        )
    for run in runs:  # all of them first, then wait
        active_runs.send_signal(run, EMERGENCY_SIGNAL if now else STOP_SIGNAL)
    for run in runs:
        if not active_runs.wait_until_ended(run, longest_ramp):
            print(
                f"the run on {run.port} has not ended in {longest_ramp:g} s; its file may be being "
                "closed. Where the rig does not rest, use its emergency stop",
                file=sys.stderr,
            )
            if longest_close is None:
                from hils.recording.recorder import DEFAULT_RECORDER

                longest_close = DEFAULT_RECORDER.close_time
            if not active_runs.wait_until_ended(run, longest_close):
                raise InputError(
                    f"the run on {run.port} (process {run.pid}) has not ended in "
                    f"{longest_ramp + longest_close:g} s; use the rig's emergency stop"
                )
        # A run that is stopped before its first tick leaves none.
        file = f"; its file is {run.output}" if Path(run.output).exists() else ""
        print(f"the run on {run.port} has ended{file}")


def stop_from_command_line(arguments: Sequence[str]) -> int | None:
    """Do what `drft hils stop` with these arguments asks for.

    Returns:
        The exit code; None where they are not understood here (--help, a mistyped option), and
        nothing was done.
    """
    given = _options(arguments)
    if given is None:
        return None
    try:
        stop_runs(*given)
        sys.stdout.flush()
    except InputError as error:
        print(f"drft: {error}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("drft: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader (`| head`) has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:  # the registry's folder cannot be made or read
        print(f"drft: {error.filename}: {error.strerror}", file=sys.stderr)
        return REFUSED
    return 0


def _options(arguments: Sequence[str]) -> tuple[str | None, bool] | None:
    """The port, and True for an emergency stop; None where there is anything else."""
    port, now, left = None, False, list(arguments)
    while left:
        each = left.pop(0)
        if each == "--now":
            now = True
        elif each == "--port" and left and not left[0].startswith("-"):
            port = left.pop(0)
        elif each.startswith("--port="):
            port = each.removeprefix("--port=")
        else:
            return None
    return port, now
