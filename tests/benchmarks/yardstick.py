"""The yardstick: the same plates, force law and step hand-written in C++, built where g++ is."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp")

# To measure its accuracy the program must take any zeta and print all digits; the step is as it is.
PROBE = (("%.5f", "%.9f"), ("B==1?.7823:", "B==1?atof(v[4]):"))


class Unavailable(Exception):
    """The yardstick cannot be built here."""


class Yardstick:
    """The compiled programs, in `folder`: one to be timed and one to be asked for sinkages."""

    def __init__(self, source: Path, folder: Path, real: str):
        if not source.is_file():
            raise Unavailable("there is no shared/yardstick/drft.cpp beside the repository")
        if shutil.which("g++") is None:
            raise Unavailable("there is no g++")
        text = source.read_text()
        probe = folder / f"probe_{real}.cpp"
        asked = text
        for old, new in PROBE:
            if old not in asked:
                raise Unavailable(f"drft.cpp no longer has {old!r}, which the probe replaces")
            asked = asked.replace(old, new)
        probe.write_text(asked)
        self._timed = self._build(source, folder / f"drft_{real}", real)
        self._probe = self._build(probe, folder / f"probe_{real}", real)

    @staticmethod
    def _build(source: Path, program: Path, real: str) -> Path:
        command = ["g++", *FLAGS, f"-DREAL={real}", str(source), "-o", str(program)]
        subprocess.run(command, check=True)
        return program

    @staticmethod
    def _run(*command: object) -> str:
        words = [str(word) for word in command]
        return subprocess.run(words, check=True, capture_output=True, text=True).stdout

    def seconds(self, runs: int, dt: float, duration: float) -> float:
        """Time it takes [s], by its own clock: without starting the program."""
        line = self._run(self._timed, runs, dt, duration)
        steps, seconds, each = re.findall(r"steps (\d+): ([\d.]+) s, ([\d.]+) us", line)[0]
        # The microseconds have more digits, the seconds only four decimals.
        return max(float(each) * 1e-6 * runs * int(steps), 0.0) or float(seconds)

    def heights(self, zeta: float, dt: float, times: np.ndarray) -> np.ndarray:
        """z [m] at `times` [s]: the program prints the last one only, so it runs up to each."""
        lines = [self._run(self._probe, 1, dt, time, zeta) for time in times]
        return np.array([float(line.split()[-1]) for line in lines])
