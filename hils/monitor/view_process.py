"""The live view: a process that draws the state of a run, and takes the stop key.

It has the terminal from the first status until the control program closes the pipe or dies, and
then gives it back. The stop key does what `drft hils stop` does.
"""

import os
import re
import select
import signal
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import msgspec
from rich.console import Console
from rich.live import Live

from hils.control.stop_request import EMERGENCY_SIGNAL, STOP_SIGNAL
from hils.monitor.dashboard import Dashboard
from hils.monitor.status import StatusReader
from hils.monitor.terminal import Keyboard
from hils.procedure.active_runs import ActiveRun, send_signal

STOP_KEYS, EMERGENCY_KEYS = b"sSqQ ", b"eE"

# Arrows and function keys, which hold letters.
_SEQUENCE: Final = re.compile(rb"\x1b(?:\[[0-9;?]*[@-~]|O.|.)?", re.DOTALL)

_INPUT, _OUTPUT = 0, 1


@dataclass(frozen=True)
class ViewSettings:
    """Rhythm of the drawing.

    Attributes:
        shortest_interval: From one picture to the next, at least [s].
        longest_interval: From one picture to the next without news [s].
    """

    shortest_interval: float = 0.15
    longest_interval: float = 0.25


DEFAULT_VIEW = ViewSettings()


class StopKey:
    """Signals that keys ask for. A key that is held down asks for one stop, never for two."""

    def __init__(self):
        self._pressed = False

    def press(self, typed: bytes) -> list[signal.Signals]:
        """Signals for the control program."""
        signals = []
        for key in _SEQUENCE.sub(b"", typed):
            if key in EMERGENCY_KEYS:
                signals.append(EMERGENCY_SIGNAL)
            elif key in STOP_KEYS and not self._pressed:
                self._pressed = True
                signals.append(STOP_SIGNAL)
        return signals


class View:
    """Draws the state of a run from a pipe until that ends.

    Args:
        pipe: Reading end of the pipe.
        run: Run that the stop key ends.
        settings: Rhythm of the drawing.
    """

    def __init__(self, pipe: int, run: ActiveRun, settings: ViewSettings = DEFAULT_VIEW):
        self._pipe, self._run, self._settings = pipe, run, settings
        self._keyboard, self._key, self._sources = Keyboard(_INPUT), StopKey(), [pipe]
        self._reader, self._dashboard = StatusReader(), Dashboard(self._keyboard.is_available)
        output = os.fdopen(_OUTPUT, "w", encoding="utf-8", errors="replace", closefd=False)
        self._live = Live(
            self._dashboard,
            console=Console(file=output, force_terminal=True, legacy_windows=False),
            screen=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def run(self) -> None:
        """Draw until the pipe ends; the terminal is given back whatever happens."""
        drawn = 0.0
        try:
            while self._read():
                now = time.monotonic()
                if self._live.is_started and now - drawn >= self._settings.shortest_interval:
                    drawn = now
                    with suppress(OSError):  # the terminal is gone
                        self._live.refresh()
        finally:
            self._keyboard.release()
            with suppress(OSError):
                self._live.stop()

    def _read(self) -> bool:
        """Take keys and news; True where more may come."""
        ready, _, _ = select.select(self._sources, [], [], self._settings.longest_interval)
        if _INPUT in ready:
            self._take_keys()
        if self._pipe not in ready:
            return True
        data = os.read(self._pipe, 2**16)
        for status in self._reader.feed(data):
            self._dashboard.add(status, time.monotonic())
            if not self._live.is_started:
                self._begin()
        return bool(data)

    def _begin(self) -> None:
        self._keyboard.read_by_key()
        with suppress(OSError):
            self._live.start()
        if self._keyboard.is_available:
            self._sources.append(_INPUT)

    def _take_keys(self) -> None:
        typed = b""
        with suppress(OSError):
            typed = os.read(_INPUT, 1024)
        if not typed:  # the terminal is gone
            self._sources.remove(_INPUT)
        for kind in self._key.press(typed):
            send_signal(self._run, kind)


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
