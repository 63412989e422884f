"""Whom the procedure talks to: a person at the terminal, or nobody."""

import abc
import math
import os
import select
import sys
import termios
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drftjax.common.errors import InputError
from hils.events import Phase

# Between two looks at the rig while a question is open [s]: it says ESTOP five times, 50 ms apart.
LOOK = 0.05


def _nothing() -> None:
    pass


class AbstractPrompts(abc.ABC):
    """Tells what happens and asks for what only hands can do."""

    @abc.abstractmethod
    def say(self, text: str) -> None:
        """Say a sentence, if anybody listens."""

    @abc.abstractmethod
    def say_if_free(self, text: str) -> None:
        """Say a sentence that may be lost: the rig waits for commands, and nothing for a screen."""

    @abc.abstractmethod
    def confirm(self, text: str, meanwhile: Callable[[], None] = _nothing) -> None:
        """Ask for something to be done, and return when it is.

        Args:
            text: What is to be done.
            meanwhile: Called again and again while the question is open; it may raise.

        Raises:
            InputError: where nobody can answer.
        """

    @abc.abstractmethod
    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        """The run comes to this phase, which lasts so long where that is known [s]."""

    @abc.abstractmethod
    def show_sinkage(self, sinkage: float) -> None:
        """The wheel that stands is measured so deep [m]; called often, and must not wait."""


def _say(text: str) -> None:
    """Print it; a reader who has gone (`| head`), or a terminal that has, ends no run."""
    try:
        print(text, flush=True)
    except OSError:
        # What is still buffered would be tried again at the program's end, and spoil its exit code.
        with suppress(OSError, ValueError), Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def _say_if_at_once(text: str) -> None:
    """Print it where that need not wait: a terminal may be halted (Ctrl-S), a pipe be full."""
    with suppress(OSError, ValueError):
        if not select.select([], [sys.stdout], [], 0.0)[1]:
            return
    _say(text)


class TerminalPrompts(AbstractPrompts):
    """A person at the terminal, who presses Enter."""

    def say(self, text: str) -> None:
        _say(text)

    def say_if_free(self, text: str) -> None:
        _say_if_at_once(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = _nothing) -> None:
        question = f"{text}, then press Enter (Ctrl-C to leave) "
        try:
            if not sys.stdin.isatty():
                input(question)
                return
            # An Enter typed before the question was read answers nothing.
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
            print(question, end="", flush=True)
            while not select.select([sys.stdin], [], [], LOOK)[0]:
                meanwhile()
            if not sys.stdin.readline():
                raise EOFError
        except BaseException as error:
            _say("")  # the question has left the line open
            if not isinstance(error, EOFError | OSError):
                raise
            raise InputError(
                "nobody is at the terminal to answer; give --yes where the rig needs no hands"
            ) from None

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        pass

    def show_sinkage(self, sinkage: float) -> None:
        pass


class UnattendedPrompts(AbstractPrompts):
    """Nobody is asked: a virtual rig, or one that prepares itself."""

    def __init__(self, quiet: bool = False):
        self._quiet = quiet

    def say(self, text: str) -> None:
        if not self._quiet:
            _say(text)

    def say_if_free(self, text: str) -> None:
        if not self._quiet:
            _say_if_at_once(text)

    def confirm(self, text: str, meanwhile: Callable[[], None] = _nothing) -> None:
        self.say(f"{text}: taken as done")

    def enter_phase(self, phase: Phase, lasts: float = math.nan) -> None:
        pass

    def show_sinkage(self, sinkage: float) -> None:
        pass
