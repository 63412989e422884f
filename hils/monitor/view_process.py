"""The live view: a process that draws what the control program tells it, and takes the stop key.

It has the terminal from the first scene until the control program closes the pipe or dies, and
then gives it back. The stop key does what `drft hils stop` does.
"""

import os
import re
import select
import signal
import sys
import time
from contextlib import suppress
from typing import Final

import msgspec

from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
from hils.monitor.dashboard import Dashboard
from hils.monitor.status import StatusReader
from hils.monitor.terminal import ENTER, LEAVE, Keyboard, write
from hils.procedure.active_runs import ActiveRun, send_signal

STOP, EMERGENCY = b"sSqQ ", b"eE"


# The picture is drawn no more often than this [s].
DRAWN: Final = 0.15


# Without news the picture is drawn anew so often [s].
PAUSE: Final = 0.25


_HOME, _LINE_END, _REST = b"\x1b[H", b"\x1b[K", b"\x1b[J"


# Arrows and function keys, which hold letters.
_SEQUENCE: Final = re.compile(rb"\x1b(?:\[[0-9;?]*[@-~]|O.|.)?", re.DOTALL)


_INPUT, _OUTPUT = 0, 1


class StopKey:
    """What keys ask for. A key that is held down asks for one stop, never for two."""

    def __init__(self):
        self._asked = False

    def press(self, typed: bytes) -> list[signal.Signals]:
        """Signals for the control program."""
        wanted = []
        for key in _SEQUENCE.sub(b"", typed):
            if key in EMERGENCY:
                wanted.append(EMERGENCY_SIGNAL)
            elif key in STOP and not self._asked:
                self._asked = True
                wanted.append(STOP_SIGNAL)
        return wanted


class View:
    """Draws scenes from a pipe until it ends.

    Args:
        scenes: The pipe's reading end.
        run: What the stop key ends.
    """

    def __init__(self, scenes: int, run: ActiveRun):
        self._pipe, self._run = scenes, run
        self._keyboard, self._key = Keyboard(_INPUT), StopKey()
        self._heard = [scenes]
        self._scenes, self._picture = StatusReader(), Dashboard()
        self._on = False
        self._drawn = 0.0

    def run(self) -> None:
        """Until the pipe ends; the terminal is given back whatever happens."""
        try:
            while self._look():
                now = time.monotonic()
                if self._on and now - self._drawn >= DRAWN:
                    self._drawn = now
                    self._draw(now)
        finally:
            if self._on:
                self._keyboard.release()
                write(_OUTPUT, LEAVE)

    def _look(self) -> bool:
        """Take what has come; whether there may be more."""
        ready, _, _ = select.select(self._heard, [], [], PAUSE)
        if _INPUT in ready:
            self._take_keys()
        if self._pipe not in ready:
            return True
        data = os.read(self._pipe, 2**16)
        for scene in self._scenes.feed(data):
            self._begin()
            self._picture.add(scene, time.monotonic())
        return bool(data)

    def _begin(self) -> None:
        if self._on:
            return
        self._on = True
        self._keyboard.read_by_key()
        write(_OUTPUT, ENTER)
        if self._keyboard.is_available:
            self._heard.append(_INPUT)

    def _take_keys(self) -> None:
        typed = b""
        with suppress(OSError):
            typed = os.read(_INPUT, 1024)
        if not typed:  # the terminal is gone
            self._heard.remove(_INPUT)
        for kind in self._key.press(typed):
            send_signal(self._run, kind)

    def _draw(self, now: float) -> None:
        try:
            width, height = os.get_terminal_size(_OUTPUT)
        except OSError:
            return
        width, height = max(width, 20), max(height, 4)
        lines = self._picture.lines(width, height, now, self._keyboard.is_available)
        text = (_LINE_END + b"\r\n").join(line.encode("utf-8", "replace") for line in lines)
        write(_OUTPUT, _HOME + text + _LINE_END + _REST)


def main() -> None:
    """Draw what comes through the pipe of this number, for the run in the second argument."""
    # Ctrl-C and Ctrl-\ are the control program's to answer. Once that has died this process may be
    # in the background, from where only those who ignore SIGTTOU may set the terminal.
    for kind in (signal.SIGINT, signal.SIGQUIT, signal.SIGTTOU, signal.SIGTTIN, signal.SIGTSTP):
        signal.signal(kind, signal.SIG_IGN)
    for kind in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(kind, _end)
    View(int(sys.argv[1]), msgspec.json.decode(sys.argv[2], type=ActiveRun)).run()


def _end(number: int, frame: object) -> None:
    raise SystemExit(128 + number)
