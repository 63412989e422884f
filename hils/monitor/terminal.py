"""Keys of the terminal while the live view has it."""

import os
import sys
from contextlib import suppress
from typing import Any, Final

_CONTROL, _LOCAL, _CHARACTERS = 0, 3, 6

_OFF: Final = b"\x00"


class Keyboard:
    """Mode of a terminal's input: as it was found, and key by key.

    Ctrl-C and Ctrl-\\ keep their meaning. Ctrl-S no longer holds the view up, and Ctrl-Z does not
    suspend a program that drives a rig.

    Args:
        descriptor: The terminal; where it is none, nothing is ever done.
    """

    def __init__(self, descriptor: int):
        self._descriptor = descriptor
        self._found = _attributes(descriptor)
        self._ours: list[Any] | None = None

    @property
    def is_available(self) -> bool:
        """True where keys can be read."""
        return self._found is not None

    def read_by_key(self) -> None:
        """Give each key at once, without an echo."""
        found = _attributes(self._descriptor)
        if found is None:
            return
        import termios

        found[_CONTROL] &= ~(termios.IXON | termios.IXOFF)
        found[_LOCAL] &= ~(termios.ECHO | termios.ICANON)
        characters = found[_CHARACTERS]
        characters[termios.VMIN], characters[termios.VTIME] = 1, 0
        characters[termios.VSUSP] = _OFF
        with suppress(termios.error, OSError):
            termios.tcsetattr(self._descriptor, termios.TCSANOW, found)
        self._ours = _attributes(self._descriptor)

    def release(self) -> None:
        """Restore the mode unless someone else has set it since; drop what was typed.

        Once the control program has died, a shell may have the terminal again and have set it for
        its own prompt.
        """
        if self._ours is not None and _attributes(self._descriptor) == self._ours:
            self.restore()
        self._ours = None

    def restore(self) -> None:
        """Restore the mode that was found."""
        if self._found is not None:
            import termios

            with suppress(termios.error, OSError):
                termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._found)


def has_own_terminal() -> bool:
    """Return True where this program has a terminal to itself on which a view can be drawn."""
    try:
        output = sys.stdout.fileno()
        # In the background the terminal is someone else's.
        mine = os.isatty(output) and os.tcgetpgrp(output) == os.getpgrp()
    except (OSError, ValueError):
        return False
    return mine and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")


def _attributes(descriptor: int) -> list[Any] | None:
    """A terminal's attributes; None where it is none, or none any more."""
    import termios

    try:
        return termios.tcgetattr(descriptor)
    except (termios.error, OSError):
        return None
