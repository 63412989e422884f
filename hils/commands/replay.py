"""`drft hils replay`: recorded runs, made again from their readings."""

from pathlib import Path
from typing import Annotated

import typer

from drftjax.commands.printing import say

EXAMPLES = """
Examples:

  drft hils replay run.h5

  drft hils replay out/*.h5

The exit code is 1 where a run does not come out bit for bit, as may be on another processor.
"""


def replay(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", show_default=False)],
) -> None:
    """Feed recorded readings to the loop again, and compare its zeta with the recorded one."""
    from drftjax.common.jax_config import configure_jax
    from hils.realtime import answer_at_once

    # As for the run itself: other flags may make other kernels, and those another last bit.
    configure_jax()
    answer_at_once()
    from drftjax.common.errors import InputError
    from drftjax.runlog.check import read_runs_guarded
    from hils.replay import replay as again

    exact = True
    for path, run in zip(files, read_runs_guarded(files), strict=True):
        try:
            made = again(run)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        say(f"{path}: {made.sentence()}")
        exact = exact and made.exact
    if not exact:
        raise typer.Exit(1)
