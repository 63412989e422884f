"""The yardstick: the same plates, force law and step hand-written in C++, built where g++ is."""

import subprocess
from pathlib import Path

import numpy as np

from drftjax.common.errors import InputError
from drftjax.simulation.speed import build_cpp, cpp_seconds

# To measure its accuracy the program must take any zeta and print all digits; the step is as it is.
PROBE = (("%.5f", "%.9f"), ("B==1?.7823:", "B==1?atof(v[4]):"))


class Unavailable(Exception):
    """The yardstick cannot be built here."""


class Yardstick:
    """The compiled programs, in `folder`: one to be timed and one to be asked for sinkages."""

    def __init__(self, source: Path, folder: Path, real: str):
        if not source.is_file():
            raise Unavailable("there is no shared/yardstick/drft.cpp beside the repository")
        text = source.read_text()
        probe = folder / f"probe_{real}.cpp"
        asked = text
        for old, new in PROBE:
            if old not in asked:
                raise Unavailable(f"drft.cpp no longer has {old!r}, which the probe replaces")
            asked = asked.replace(old, new)
        probe.write_text(asked)
        try:
            self._timed = build_cpp(source, folder / f"drft_{real}", real)
            self._probe = build_cpp(probe, folder / f"probe_{real}", real)
        except InputError as why:
            raise Unavailable(str(why)) from why

    @staticmethod
    def _run(*command: object) -> str:
        words = [str(word) for word in command]
        return subprocess.run(words, check=True, capture_output=True, text=True).stdout

    def seconds(self, runs: int, dt: float, duration: float) -> float:
        """Time it takes [s], by its own clock: without starting the program."""
        return cpp_seconds(self._timed, runs, dt, duration)

    def heights(self, zeta: float, dt: float, times: np.ndarray) -> np.ndarray:
        """z [m] at `times` [s]: the program prints the last one only, so it runs up to each."""
        lines = [self._run(self._probe, 1, dt, time, zeta) for time in times]
        return np.array([float(line.split()[-1]) for line in lines])
