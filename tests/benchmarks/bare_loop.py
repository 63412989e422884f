"""What the machine lets a loop of the same period do: sleep to a deadline, spin, nothing else.

    python -m tests.benchmarks.bare_loop 0.001 24 0.0002 --fifo

No link, no recorder, no JAX, no second thread: deadlines missed here are missed by the machine.
"""

import argparse
import gc
import os
import time
from contextlib import suppress

import numpy as np

MARGIN = 0.01  # before the first deadline [s]


def spin(tick: float, seconds: float, work: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Deadlines missed, those of ticks that are skipped too, and each tick's lateness and work [s].

    Args:
        tick: Period [s].
        seconds: How long [s].
        work: How long each tick spins [s].
    """
    count = round(seconds / tick)
    late, busy = np.zeros(count), np.zeros(count)
    missed = 0
    deadline = time.monotonic() + MARGIN
    for number in range(count):
        time.sleep(max(deadline - time.monotonic(), 0.0))
        woken = time.monotonic()
        while time.monotonic() - woken < work:
            pass
        done = time.monotonic()
        late[number], busy[number] = woken - deadline, done - woken
        deadline += tick
        if done > deadline:
            passed = int((done - deadline) // tick) + 1
            missed += passed
            deadline += tick * passed
    return missed, late, busy


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("tick", type=float)
    options.add_argument("seconds", type=float)
    options.add_argument("work", type=float)
    options.add_argument("--fifo", action="store_true")
    given = options.parse_args()
    if given.fifo:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    gc.disable()
    missed, late, busy = spin(given.tick, given.seconds, given.work)
    figures = (1e3 * np.percentile(each, [50, 99.9, 100]) for each in (busy, late))
    print(missed, *("  ".join(f"{value:.3f}" for value in each) for each in figures), sep="  ")


if __name__ == "__main__":
    main()
