"""Progress of a long command: a bar in a terminal, a line from time to time elsewhere."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

# A log that is followed shows in so many seconds that the command still works.
LINE_INTERVAL = 10.0


class Show(Protocol):
    """Function that shows what a command is at."""

    def __call__(self, stage: str, done: int | None = None, total: int | None = None) -> None:
        """Show the next stage.

        Args:
            stage: In words.
            done: Pieces that are done, where their number is known; None leaves it.
            total: Number of the stage's pieces; None leaves it. With a number there is a bar, and
                an estimate of the time that is left.
        """


class _WhereCounted(ProgressColumn):
    """Column of a progress that is empty as long as the number of pieces is not known."""

    def __init__(self, column: ProgressColumn):
        super().__init__()
        self._column = column

    def render(self, task: Task) -> RenderableType:
        """The column, or nothing."""
        return "" if task.total is None else self._column.render(task)


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
        pieces = (BarColumn(bar_width=20), MofNCompleteColumn(), TimeRemainingColumn())
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        columns += tuple(map(_WhereCounted, pieces))
        with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
            task = bar.add_task(stage, total=total)
            yield lambda stage, done=None, total=None: bar.update(
                task, description=stage, completed=done, total=total
            )
        return
    latest: dict[str, Any] = {"stage": stage, "done": 0, "total": total}
    ended, begun = threading.Event(), time.monotonic()

    def repeat() -> None:
        while not ended.wait(interval):
            pieces = "" if latest["total"] is None else ": {done} of {total}".format(**latest)
            line = f"{latest['stage']}{pieces} ({time.monotonic() - begun:.0f} s)"
            print(line, file=sys.stderr, flush=True)

    def show(stage: str, done: int | None = None, total: int | None = None) -> None:
        given = {"stage": stage, "done": done, "total": total}
        latest.update({name: each for name, each in given.items() if each is not None})

    # Compiling gives no sign of life for longer than the interval, so a clock of its own speaks.
    speaker = threading.Thread(target=repeat, daemon=True)
    speaker.start()
    try:
        yield show
    finally:
        ended.set()
        speaker.join()
