"""Ten million spoilt frames into a decoder, a host's receiver and a rig.

    python -m tests.benchmarks.frames                       # about two minutes on one core
    python -m tests.benchmarks.frames --frames 100000

Nothing corrupt may be taken, nothing may crash, and each batch is done in a bounded time; it ends
with what became of them, by cause.
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.helpers.frame_fuzzer import Tally, judge_batch

BATCH = 20_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    tally, start, longest = Tally(), time.perf_counter(), 0.0
    for batch in range(-(-asked.frames // BATCH)):
        began = time.perf_counter()
        judge_batch(asked.seed + batch, BATCH, tally)
        longest = max(longest, time.perf_counter() - began)
    duration = time.perf_counter() - start
    print(f"{tally.spoilt} spoilt frames in {duration:.0f} s, longest batch {longest:.2f} s")
    print(f"{tally.counted} frames taken by the host, every one as it was sent")
    print(f"{tally.obeyed} times the rig ran, never past its limits")
    for cause, count in tally.drops.most_common():
        print(f"{count:9d} dropped: {cause.value}")


if __name__ == "__main__":
    main()
