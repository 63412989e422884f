"""`make bench` prints the tables; no time is asserted, for that depends on the machine."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_speed_beside_the_yardstick():
    subprocess.run([sys.executable, "-m", "tests.benchmarks.speed"], cwd=ROOT, check=True)
