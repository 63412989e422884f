"""The terminal while the live view has it, and giving it back."""

import os
import sys
import termios
from contextlib import suppress
from typing import Any, Final

# To the other screen and back, the cursor hidden and shown: what was there before stays.
ENTER: Final = b"\x1b[?1049h\x1b[?25l\x1b[2J"


LEAVE: Final = b"\x1b[0m\x1b[?25h\x1b[?1049l"


_CONTROL, _LOCAL, _CHARACTERS = 0, 3, 6


_OFF: Final = b"\x00"


class Keyboard:
    """A terminal's way with what is typed: as it was found, and key by key.

    Ctrl-C and Ctrl-\\ stay what they are. Ctrl-S no longer holds the view up, and Ctrl-Z does not
    suspend a program that drives a rig.

    Args:
        descriptor: The terminal; where it is none, nothing is ever done.
    """

    def __init__(self, descriptor: int):
        self._descriptor = descriptor
        self._found = attributes(descriptor)
        self._ours: list[Any] | None = None

    @property
    def is_available(self) -> bool:
        """Whether keys can be read."""
        return self._found is not None

    def read_by_key(self) -> None:
        """Give each key at once, unseen."""
        found = attributes(self._descriptor)
        if found is None:
            return
        found[_CONTROL] &= ~(termios.IXON | termios.IXOFF)
        found[_LOCAL] &= ~(termios.ECHO | termios.ICANON)
        characters = found[_CHARACTERS]
        characters[termios.VMIN], characters[termios.VTIME] = 1, 0
        characters[termios.VSUSP] = _OFF
        _apply(self._descriptor, termios.TCSANOW, found)
        self._ours = attributes(self._descriptor)

    def release(self) -> None:
        """As it was found, unless someone else has set it since; what was typed is dropped.

        Once the control program has died, a shell may have the terminal again and have set it for
        its own prompt.
        """
        if self._ours is not None and attributes(self._descriptor) == self._ours:
            self.restore()
        self._ours = None

    def restore(self) -> None:
        """As it was found."""
        if self._found is not None:
            _apply(self._descriptor, termios.TCSAFLUSH, self._found)


def attributes(descriptor: int) -> list[Any] | None:
    """A terminal's attributes; None where it is none, or none any more."""
    try:
        return termios.tcgetattr(descriptor)
    except (termios.error, OSError):
        return None


def has_own_terminal() -> bool:
    """Whether this program has a terminal to itself on which a view can be drawn."""
    try:
        output = sys.stdout.fileno()
        # In the background the terminal is someone else's.
        mine = os.isatty(output) and os.tcgetpgrp(output) == os.getpgrp()
    except (OSError, ValueError):
        return False
    return mine and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")


def write(descriptor: int, data: bytes) -> None:
    """All of it; a terminal that is gone takes nothing."""
    with suppress(OSError):
        while data:
            data = data[os.write(descriptor, data) :]


def _apply(descriptor: int, when: int, wanted: list[Any]) -> None:
    with suppress(termios.error, OSError):
        termios.tcsetattr(descriptor, when, wanted)
