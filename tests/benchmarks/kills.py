"""Kills of the control program, of its recorder and of both, at random times: what is lost.

    python -m tests.benchmarks.kills [--kills 200] [--seed 0]

prints the table of docs/reference/runlog.md. Each kill is a SIGKILL while rows of 1 kHz are
recorded, from 0 to 1.2 s after the first of them are committed. Every row kept is compared with the
one that was handed over.
"""

import argparse
import os
import platform
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.helpers.recording_host import trial

VICTIMS = (("host",), ("recorder",), ("host", "recorder"))


def main() -> None:
    """Kill, and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    dice, start = random.Random(given.seed), time.monotonic()
    print(f"{platform.platform()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print("| killed | kills | ticks that had to be kept | kept | lost | wrong |")
    print("|---|---|---|---|---|---|")
    for place, victims in enumerate(VICTIMS):
        kills = given.kills // 3 + (place < given.kills % 3)
        wanted = kept = lost = wrong = 0
        for _ in range(kills):
            with tempfile.TemporaryDirectory() as folder:
                least, found, differing = trial(Path(folder), victims, dice)
            wanted, kept = wanted + least, kept + found
            lost, wrong = lost + max(0, least - found), wrong + differing
        names = " and ".join(victims)
        print(f"| {names} | {kills} | {wanted} | {kept} | {lost} | {wrong} |", flush=True)
    print(f"{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
