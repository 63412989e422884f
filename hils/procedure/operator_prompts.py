"""Prompts of the procedure: to a person at the terminal, or to nobody."""

import abc
import math
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drftjax.common.errors import InputError
from hils.events import Phase

# From one look at the rig to the next while a question is open [s].
POLL_INTERVAL = 0.05

# From one sign of life to the next while something takes long [s]: with the time that Python takes
# to start, no second passes in silence.
LIFE_INTERVAL = 0.5


# Beyond the time of a usual start [s] a sign comes each so many [s].
USUAL_START, LONG_INTERVAL = 6.0, 5.0


def _do_nothing() -> None:
    pass


class AbstractPrompts(abc.ABC):
    """Messages about a run, and requests for manual steps."""

    @abc.abstractmethod
    def say(self, text: str) -> None:
        """Say a sentence, if anybody listens."""

    @abc.abstractmethod
    def say_if_free(self, text: str) -> None:
        """Say a sentence unless that would have to wait: the rig waits for commands."""

    @abc.abstractmethod
    def confirm(self, text: str, meanwhile: Callable[[], None] = _do_nothing) -> None:
        """Ask for a manual step, and return when it is done.

        Args:
            text: The step.
            meanwhile: Called again and again while the question is open; it may raise.

        Raises:
            InputError: nobody can answer.
        """

    @abc.abstractmethod
    def accept(self, doubt: str) -> bool:
        """Ask whether to go on in spite of a doubt; False where nobody says so.

        Args:
            doubt: A sentence without its full stop.
        """

    @abc.abstractmethod
    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        """Announce a phase of the run.

        Args:
            phase: It begins now.
            lasts: Its length [s]; NaN where that is not known.
        """

    @abc.abstractmethod
    def show_sinkage(self, sinkage: float) -> None:
        """Show the measured sinkage of a standing wheel [m]; called often, and must not wait."""


def _print(text: str) -> None:
    """Print it; a reader who has gone (`| head`), or a terminal that has, ends no run."""
    try:
        print(text, flush=True)
    except OSError:
        # What is still buffered would be tried again at the program's end, and spoil its exit code.
        with suppress(OSError, ValueError), Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def _print_if_free(text: str) -> None:
    """Print it where that need not wait: a terminal may be halted (Ctrl-S), a pipe be full."""
    with suppress(OSError, ValueError):
        if not select.select([], [sys.stdout], [], 0.0)[1]:
            return
    _print(text)


@contextmanager
def signs_of_life(
    text: str, say: Callable[[str], None] = _print, interval: float = LIFE_INTERVAL
) -> Iterator[None]:
    """Context in which a sentence is said again and again, with the time that has passed.

    Args:
        text: The work that takes long.
        say: Takes the sentence; called from a thread.
        interval: From one sentence to the next [s]; work that is done sooner is not mentioned, of
            work that takes longer than a usual start there are fewer.
    """
    ended, begun = threading.Event(), time.monotonic()

    def repeat() -> None:
        wait = interval
        while not ended.wait(wait):
            passed = time.monotonic() - begun
            say(f"{text} ({passed:.1f} s)")
            # Work that takes so long is followed by nobody.
            wait = interval if passed < USUAL_START else LONG_INTERVAL

    speaker = threading.Thread(target=repeat, name="signs of life", daemon=True)
    speaker.start()
    try:
        yield
    finally:
        ended.set()
        speaker.join()


class TerminalPrompts(AbstractPrompts):
    """Prompts to a person at the terminal, who presses Enter.

    Args:
        poll_interval: From one look at the rig to the next while a question is open [s]: a rig
            sends ESTOP five times, 50 ms apart (docs/reference/wire.md).
    """

    def __init__(self, poll_interval: float = POLL_INTERVAL):
        self._poll_interval = poll_interval

    def say(self, text: str) -> None:
        _print(text)

    def say_if_free(self, text: str) -> None:
        _print_if_free(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = _do_nothing) -> None:
        question = f"{text}, then press Enter (Ctrl-C to leave) "
        try:
            if not sys.stdin.isatty():
                input(question)
                return
            import termios

            # An Enter typed before the question was read answers nothing.
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
            print(question, end="", flush=True)
            while not select.select([sys.stdin], [], [], self._poll_interval)[0]:
                meanwhile()
            if not sys.stdin.readline():
                raise EOFError
        except BaseException as error:
            _print("")  # the question has left the line open
            if not isinstance(error, EOFError | OSError):
                raise
            raise InputError(
                "nobody is at the terminal to answer; give --yes where the rig needs no hands"
            ) from None

    def accept(self, doubt: str) -> bool:
        try:
            answer = input(f"{doubt[0].upper()}{doubt[1:]}. Go on all the same? [y/N] ")
        except (EOFError, OSError):
            return False
        return answer.strip().lower() in ("y", "yes")

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        pass

    def show_sinkage(self, sinkage: float) -> None:
        pass


class UnattendedPrompts(AbstractPrompts):
    """Prompts without a person: a virtual rig, or one that prepares itself.

    Args:
        quiet: True to say nothing either.
    """

    def __init__(self, quiet: bool = False):
        self._quiet = quiet

    def say(self, text: str) -> None:
        if not self._quiet:
            _print(text)

    def say_if_free(self, text: str) -> None:
        if not self._quiet:
            _print_if_free(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = _do_nothing) -> None:
        self.say(f"{text}: taken as done")

    def accept(self, doubt: str) -> bool:
        return False

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        pass

    def show_sinkage(self, sinkage: float) -> None:
        pass
