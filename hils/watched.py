"""A run with the live view, or without."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from hils.clock import AbstractClock
from hils.link import AbstractLink
from hils.live_view import LiveView
from hils.onlooker import Onlooker, Seen
from hils.operator_dialogue import AbstractDialogue
from hils.procedure import Procedure
from hils.rows import Rows
from hils.stop_request import StopRequest
from hils.under_way import UnderWay


class Watched(NamedTuple):
    """Where a run's rows and words go.

    Attributes:
        rows, dialogue: To give to the run.
        begin: Lets the view have the terminal; no question can be asked from then on.
    """

    rows: Rows
    dialogue: AbstractDialogue
    begin: Callable[[], None]


def unwatched(rows: Rows, dialogue: AbstractDialogue) -> Watched:
    """Nobody looks on."""
    return Watched(rows, dialogue, lambda: None)


@contextmanager
def watched(
    under_way: UnderWay,
    output: Path,
    procedure: Procedure,
    link: AbstractLink,
    clock: AbstractClock,
    rows: Rows,
    dialogue: AbstractDialogue,
    stop: StopRequest,
) -> Iterator[Watched]:
    """Within this there is a live view.

    What is told while the view has the terminal is told to the dialogue at the end.
    """
    setup = procedure.loop.setup
    command = setup.command.build()
    seen = Seen(
        procedure.title or setup.title,
        under_way.port,
        str(output.absolute()),
        float(command.time[-1] - command.time[0]),
        setup.wheel.radius,
    )
    view = LiveView(under_way)
    onlooker = Onlooker(seen, view.show, clock, link.quality, stop)
    try:
        yield Watched(onlooker.rows(rows), onlooker.dialogue(dialogue), onlooker.begin)
    finally:
        view.close()
        for text in onlooker.end():
            dialogue.tell(text)
