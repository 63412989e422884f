"""Progress of a long command: a bar in a terminal, a line from time to time elsewhere."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

# A log that is followed shows in so many seconds that the command still works.
LINE_INTERVAL = 10.0


class Show(Protocol):
    """Function that shows what a command is at."""

    def __call__(self, stage: str, done: int | None = None) -> None:
        """Show the next stage.

        Args:
            stage: In words.
            done: Pieces that are done, where their number is known; None leaves it.
        """


@contextmanager
def progress_line(
    console: Console,
    stage: str,
    *,
    total: int | None = None,
    quiet: bool = False,
    interval: float = LINE_INTERVAL,
) -> Iterator[Show]:
    """Show what a command is at, until the block ends.

    Args:
        console: Where results are printed. Where it is no terminal, lines go to standard error.
        stage: The first stage.
        total: Number of pieces, where it is known.
        quiet: True to show nothing.
        interval: Time from line to line where there is no terminal [s].

    Yields:
        A function that takes the next stage.
    """
    if quiet or console.is_terminal:
        pieces = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        columns += () if total is None else pieces
        with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
            task = bar.add_task(stage, total=total)
            yield lambda stage, done=None: bar.update(task, description=stage, completed=done)
        return
    latest, ended, begun = {"stage": stage, "done": 0}, threading.Event(), time.monotonic()

    def repeat() -> None:
        while not ended.wait(interval):
            pieces = "" if total is None else f": {latest['done']} of {total}"
            line = f"{latest['stage']}{pieces} ({time.monotonic() - begun:.0f} s)"
            print(line, file=sys.stderr, flush=True)

    def show(stage: str, done: int | None = None) -> None:
        latest.update({"stage": stage} if done is None else {"stage": stage, "done": done})

    # Compiling gives no sign of life for longer than the interval, so a clock of its own speaks.
    speaker = threading.Thread(target=repeat, daemon=True)
    speaker.start()
    try:
        yield show
    finally:
        ended.set()
        speaker.join()
