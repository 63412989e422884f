"""A rig's firmware in C that shares no code with the project, as a process at a pseudo-terminal."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.helpers.c_firmware import compile_c

SOURCE = Path(__file__).resolve().parents[3] / "shared" / "firmware" / "rig.c"
# To make the terminal it takes some milliseconds, on a busy computer more [s].
LONGEST_START = 10.0


def build(folder: Path) -> Path:
    """Build it; the program. Without a compiler or its source the test is skipped."""
    if not SOURCE.is_file():
        pytest.skip("there is no firmware/rig.c in the folder ../shared")
    return compile_c(folder / "rig", "-w", "-O2", SOURCE, "-lm", "-lutil")


class Firmware:
    """The running firmware, and its own log of what it heard and did."""

    def __init__(self, folder: Path, process: subprocess.Popen[bytes]):
        self.port, self._log, self._process = folder / "port", folder / "log", process

    def end(self) -> str:
        """End it, and return its log."""
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(LONGEST_START)
        return self._log.read_text(errors="replace")


@contextmanager
def running(program: Path, folder: Path, **options: float) -> Iterator[Firmware]:
    """Run it with options by their names in its `main`."""
    folder.mkdir(exist_ok=True)
    given = [f"{name}={value}" for name, value in options.items()]
    process = subprocess.Popen([program, folder / "port", folder / "log", *given])
    with suppress(OSError):  # where it is allowed, so that other work does not hold it up
        os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(49))
    try:
        deadline = time.monotonic() + LONGEST_START
        while not (folder / "port").exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield Firmware(folder, process)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
