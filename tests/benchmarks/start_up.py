"""Time from the start of a command to its effect: HELLO answered, ARM, and the signal of a stop.

    python -m tests.benchmarks.start_up --runs 6

`drft hils run --yes` on a virtual rig, again and again; its first run fills the cache of compiled
programs and does not count. HELLO counts as answered when the program says how it found the rig,
which each run but the first finds SAFE. `drft hils stop --now` signals a process that only waits.
"""

import argparse
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hils.procedure.active_runs import registered
from tests.benchmarks.loop import PROFILE, machine

DRFT = [sys.executable, "-m", "drftjax.commands.entry"]
STOPS = 10


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--runs", type=int, default=6)
    given = options.parse_args()
    print(machine())
    times = [_time_to_signal() for _ in range(STOPS)]
    print(f"stop --now: {np.median(times):.3f} s to the signal, median; most {max(times):.3f} s")
    print("run      HELLO    ARM  longest silence [s]")
    found = []
    with tempfile.TemporaryDirectory() as folder, _rig(Path(folder)) as armed:
        for number in range(given.runs):
            times = _start_run(Path(folder), number, armed)
            print(f"{number:3d}     {times[0]:6.2f} {times[1]:6.2f} {times[2]:6.2f}", flush=True)
            found += [times] * (number > 0)
    for name, figures in ("median", np.median(found, axis=0)), ("most", np.max(found, axis=0)):
        print(f"{name:7} {figures[0]:6.2f} {figures[1]:6.2f} {figures[2]:6.2f}")


@contextmanager
def _rig(folder: Path) -> Iterator["queue.Queue[float]"]:
    """A virtual rig; the times at which it was armed."""
    process = subprocess.Popen(
        [*DRFT, "hils", "rig", "--link", folder / "port"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    armed: queue.Queue[float] = queue.Queue()

    def listen() -> None:
        assert process.stderr is not None
        for line in process.stderr:
            if line.rstrip().endswith("ARMED"):
                armed.put(time.monotonic())

    threading.Thread(target=listen, daemon=True).start()
    try:
        yield armed
    finally:
        process.terminate()
        process.wait()


def _start_run(
    folder: Path, number: int, armed: "queue.Queue[float]"
) -> tuple[float, float, float]:
    """Start a run until ARM: times of HELLO and of ARM, and the longest silence [s]."""
    begun, lines = time.monotonic(), []
    run = subprocess.Popen(
        [
            *(*DRFT, "hils", "run", "--port", folder / "port", "--profile", PROFILE),
            *("-o", folder / f"{number}.h5", "--yes", "--no-ui", "--no-plot"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )

    def listen() -> None:
        assert run.stdout is not None
        lines.extend((time.monotonic() - begun, line) for line in run.stdout)

    reader = threading.Thread(target=listen)
    reader.start()
    arm = armed.get(timeout=120) - begun
    run.send_signal(signal.SIGUSR1)
    run.wait()
    reader.join()
    hello = [when for when, line in lines if line.startswith("The rig was SAFE")]
    told = [0.0, *(when for when, _ in lines if when < arm), arm]
    return hello[0] if hello else float("nan"), arm, float(np.diff(told).max())


def _time_to_signal() -> float:
    """Time from the start of `drft hils stop --now` to its signal [s]."""
    with tempfile.TemporaryDirectory() as folder:
        # The child announces itself as a run, and waits.
        answer, ours = os.pipe()
        if (child := os.fork()) == 0:
            signal.signal(signal.SIGUSR1, lambda *_: os._exit(0))
            with registered(folder, [Path("run.h5")]):
                os.write(ours, b"1")
                time.sleep(60)
            os._exit(1)
        os.read(answer, 1)
        begun = time.monotonic()
        stop = subprocess.Popen(
            [*DRFT, "hils", "stop", "--now", "--port", folder], stdout=subprocess.DEVNULL
        )
        os.waitpid(child, 0)
        taken = time.monotonic() - begun
        stop.wait()
        for each in (answer, ours):
            os.close(each)
        return taken


if __name__ == "__main__":
    main()
