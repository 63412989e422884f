"""The control program's side of the live view: scenes go into a pipe and never wait.

The view is a process of its own (`hils.monitor.view_process`), so nothing that it does or suffers
reaches the loop: a scene that finds the pipe full, or nobody at its end, is dropped. The view has
the terminal from the first scene until the pipe ends, and gives it back also where this program was
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
from hils.monitor.terminal import LEAVE, Keyboard, write
from hils.procedure.active_runs import ActiveRun

PATIENCE: Final = 3.0


"""Time in which the view must have given the terminal back before it is killed [s]."""


_START: Final = program("hils.monitor.view_process", "main")


_INPUT, _OUTPUT = 0, 1


class LiveView:
    """Shows scenes of one run on this program's terminal, and takes the stop key.

    Args:
        run: What the stop key ends.
    """

    def __init__(self, run: ActiveRun):
        self._keyboard = Keyboard(_INPUT)
        self._shown = False
        taken, self._pipe = os.pipe()
        try:
            os.set_blocking(self._pipe, False)
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-c", _START, str(taken), msgspec.json.encode(run).decode()],
                pass_fds=[taken],
                stderr=subprocess.DEVNULL,
            )
        except BaseException:
            os.close(self._pipe)
            raise
        finally:
            os.close(taken)
        self._guardian = threading.Thread(target=self._tidy_up, name="live view", daemon=True)
        self._guardian.start()

    @property
    def pid(self) -> int:
        """The view's process."""
        return self._process.pid

    def show(self, scene: RunStatus) -> None:
        """Hand a scene over, or drop it."""
        self._shown = True
        if self._pipe >= 0:
            with suppress(OSError):
                os.write(self._pipe, scene.line())

    def close(self) -> None:
        """End the view; the terminal is as it was. Further calls do nothing."""
        if self._pipe < 0:
            return
        pipe, self._pipe = self._pipe, -1
        os.close(pipe)
        self._guardian.join(PATIENCE)
        if self._guardian.is_alive():
            self._process.kill()
            self._guardian.join(PATIENCE)

    def _tidy_up(self) -> None:
        """Give the terminal back where the view ended without doing so."""
        if self._process.wait() != 0 and self._shown:
            self._keyboard.restore()
            write(_OUTPUT, LEAVE)
