"""`drft hils rig` as a process of its own, and a host that drives it until it is killed."""

import os
import queue
import re
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

DRFT = [sys.executable, "-m", "drftjax.commands.main"]
PATIENCE = 60.0  # for anything to happen at all [s]

QUICK_RIG = """
[physics]
step = 1e-3
plate_size = 0.008
"""

# A host that arms the rig and streams commands until it is killed.
HOST = """
import itertools, os, sys, time
from hils.link.messages import Arm, Drive, Frame, Hello, encode
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
seq = itertools.count(1)
def send(message): os.write(port, encode(Frame(message, 9, next(seq), 0)))
send(Hello(10_000, 50)); time.sleep(0.2)
send(Arm())
begun = time.monotonic()
for tick in itertools.count(1):
    send(Drive(0.3 if tick > 50 else 0.0, 0.0, False, 50))
    try: os.read(port, 65536)
    except BlockingIOError: pass
    time.sleep(max(0.0, begun + 0.01 * tick - time.monotonic()))
"""


class Rig:
    """Running `drft hils rig`."""

    def __init__(self, folder: Path, *arguments: object, quick: bool = True):
        setup = folder / "rig.toml"
        setup.write_text(QUICK_RIG if quick else "")
        self.process = subprocess.Popen(
            [*DRFT, "hils", "rig", "--setup", str(setup), *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.lines: queue.Queue[tuple[float, str]] = queue.Queue()
        assert self.process.stdout is not None
        self.name = self.process.stdout.readline().strip()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.put((time.monotonic(), line))

    def says(self, pattern: str) -> tuple[float, re.Match[str]]:
        """Wait for a line; its time [s] and its match."""
        deadline = time.monotonic() + PATIENCE
        while True:
            when, line = self.lines.get(timeout=max(0.0, deadline - time.monotonic()))
            if match := re.search(pattern, line):
                return when, match

    def end(self) -> int:
        self.process.terminate()
        return self.process.wait(PATIENCE)


def open_raw(name: str) -> int:
    """Open a terminal for bytes as they are; its file descriptor."""
    port = os.open(name, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(port)
    return port
