"""The control program's side of the live view: the run's status goes into a pipe and never waits.

The view is a process of its own (`hils.monitor.view_process`), so nothing that it does or suffers
reaches the loop: a status that finds the pipe full, or nobody at its end, is dropped. The view has
the terminal from the first one until the pipe ends, and gives it back also where this program was
killed. Where the view itself was killed, this program does.
"""

import os
import subprocess
import sys
import threading
from contextlib import suppress
from typing import Final

import msgspec

from drftjax.common.child_process import program
from hils.monitor.status import RunStatus
from hils.monitor.terminal import Keyboard
from hils.procedure.active_runs import ActiveRun

# To the ordinary screen, its cursor shown and its colours reset.
LEAVE: Final = b"\x1b[0m\x1b[?25h\x1b[?1049l"


_START: Final = program("hils.monitor.view_process", "main")


_INPUT, _OUTPUT = 0, 1


class LiveView:
    """Shows the status of one run on this program's terminal, and takes the stop key.

    Args:
        run: Run that the stop key ends.
        patience: Time in which the view must have given the terminal back before it is killed [s].
    """

    def __init__(self, run: ActiveRun, patience: float = 3.0):
        self._keyboard, self._patience = Keyboard(_INPUT), patience
        self._shown = False
        reading_end, self._pipe = os.pipe()
        try:
            os.set_blocking(self._pipe, False)
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-I",
                    "-c",
                    _START,
                    str(reading_end),
                    msgspec.json.encode(run).decode(),
                ],
                pass_fds=[reading_end],
                stderr=subprocess.DEVNULL,
            )
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(reading_end)
        self._guardian = threading.Thread(
            target=self._restore_terminal, name="live view", daemon=True
        )
        self._guardian.start()

    @property
    def pid(self) -> int:
        """Process of the view."""
        return self._process.pid

    def show(self, status: RunStatus) -> None:
        """Hand a status over, or drop it."""
        self._shown = True
        if self._pipe >= 0:
            with suppress(OSError):
                os.write(self._pipe, status.line())

    def close(self) -> None:
        """End the view; the terminal is as it was. Further calls do nothing."""
        if self._pipe < 0:
            return
        pipe, self._pipe = self._pipe, -1
        os.close(pipe)
        self._guardian.join(self._patience)
        if self._guardian.is_alive():
            self._process.kill()
            self._guardian.join(self._patience)

    def _restore_terminal(self) -> None:
        """Give the terminal back where the view ended without doing so."""
        if self._process.wait() != 0 and self._shown:
            self._keyboard.restore()
            with suppress(OSError):
                os.write(_OUTPUT, LEAVE)
