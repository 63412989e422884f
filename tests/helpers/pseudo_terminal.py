"""Pseudo-terminal as a person uses it: a program in the foreground, keys in, text out."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path
from typing import Any

PATIENCE = 30.0  # for anything to happen at all on a busy machine [s]

# As a shell does: it leads the session, and outlives what it runs.
SHELL = """
import os, signal, subprocess, sys, time
os.login_tty(int(sys.argv[1]))
for kind in (signal.SIGINT, signal.SIGQUIT):
    signal.signal(kind, lambda *_: None)  # Ctrl-C and Ctrl-backslash are for the program
code = subprocess.call(sys.argv[2:])
os.write(1, f"left with {code}\\n".encode())  # in one piece, whoever else writes there
time.sleep(600)
"""


class PseudoTerminal:
    """A terminal with a program in its foreground."""

    def __init__(self, command: list[str], folder: Path, width: int = 100, height: int = 30):
        self._master, self._slave = pty.openpty()
        size = struct.pack("HHHH", height, width, 0, 0)
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, size)
        self.before = self.mode()
        self._text = b""
        self._shell = subprocess.Popen(
            [sys.executable, "-c", SHELL, str(self._slave), *command],
            pass_fds=[self._slave],
            env={**os.environ, "TERM": "xterm-256color"},
            cwd=folder,
        )
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            while data := os.read(self._master, 65536):
                self._text += data
        except OSError:
            return

    @property
    def text(self) -> str:
        return self._text.decode("utf-8", "replace")

    @property
    def leader(self) -> int:
        """Process that leads the session."""
        return self._shell.pid

    def mode(self) -> list[Any]:
        return termios.tcgetattr(self._slave)

    def type(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def sees(self, pattern: str) -> re.Match[str]:
        """Wait for text; its first match on the screen since the start."""
        found: list[re.Match[str]] = []

        def there() -> bool:
            found.extend(re.finditer(pattern, self.text))
            return bool(found)

        assert soon(there), f"{pattern} not in:\n{self.text[-3000:]}"
        return found[0]

    def ends(self) -> int:
        """Wait for the end of the program; its exit code."""
        return int(self.sees(r"left with (-?\d+)")[1])

    def close(self) -> None:
        self._shell.kill()
        self._shell.wait()
        os.close(self._slave)


def soon(holds) -> bool:
    """Wait until a condition holds; False if it does not within `PATIENCE`."""
    deadline = time.monotonic() + PATIENCE
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True
