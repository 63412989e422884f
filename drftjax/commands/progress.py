"""Progress of a long command: a spinner in a terminal, a line from time to time elsewhere."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

# A log that is followed shows in so many seconds that the command still works.
LINE_INTERVAL = 10.0


@contextmanager
def progress_line(
    console: Console, stage: str, *, quiet: bool = False, interval: float = LINE_INTERVAL
) -> Iterator[Callable[[str], None]]:
    """Show what a command is at, until the block ends.

    Args:
        console: Where results are printed. Where it is no terminal, lines go to standard error.
        stage: The first stage.
        quiet: True to show nothing.
        interval: Time from line to line where there is no terminal [s].

    Yields:
        A function that takes the next stage.
    """
    if quiet or console.is_terminal:
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
            task = bar.add_task(stage, total=None)
            yield lambda text: bar.update(task, description=text)
        return
    latest, ended, begun = [stage], threading.Event(), time.monotonic()

    def repeat() -> None:
        while not ended.wait(interval):
            print(f"{latest[0]} ({time.monotonic() - begun:.0f} s)", file=sys.stderr, flush=True)

    # Compiling gives no sign of life for longer than the interval, so a clock of its own speaks.
    speaker = threading.Thread(target=repeat, daemon=True)
    speaker.start()
    try:
        yield lambda text: latest.__setitem__(0, text)
    finally:
        ended.set()
        speaker.join()
