"""Speed of simulated runs on this machine, beside the same model in plain NumPy and in C++.

The run is the 24 s profile of Fuke, Ishikawa & Ishigami 2024; an ensemble has zeta from 0.6 to 1.
"""

import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError, missing_path
from drftjax.common.rich_text import WholeWordTable
from drftjax.physics.command import Command, command_at
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.runlog.record import RecordedCommand
from drftjax.simulation.ensemble import simulate_ensemble
from drftjax.simulation.plain_numpy import simulate_in_numpy
from drftjax.simulation.rollout import simulate, step_times
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial

TIMES = np.array([0.0, 2.0, 7.0, 17.0, 22.0, 24.0])
"""Knots of the profile [s]."""
OMEGA = np.pi / 6 * np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
"""Angular velocity at the knots [rad/s]."""
SINKAGE = 0.0176
"""At the start [m]."""
ENSEMBLE_ZETA = (0.6, 1.0)
LINEAR_STEP = 2e-3
"""Step of the programs whose step is linearly implicit [s]: from 4 ms on they chatter."""
ROW = 0.1
"""Time between the rows that an ensemble keeps [s]."""

CPP_FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp")
CPP_ANSWER = re.compile(r"steps (\d+): ([\d.]+) s, ([\d.]+) us")


@dataclass(frozen=True)
class Speed:
    """Time that one program took.

    Attributes:
        program: Its name.
        runs: Runs that it made.
        step: Its step [s].
        seconds: Time that they took [s], compilation left out.
    """

    program: str
    runs: int
    step: float
    seconds: float

    @property
    def per_second(self) -> float:
        """Runs a second [1/s]."""
        return self.runs / self.seconds

    @property
    def per_step(self) -> float:
        """Time of one step of one run [s]."""
        return self.seconds / self.runs / round(TIMES[-1] / self.step)


def profile(step: float) -> Command:
    """Commands of the profile at the end of every step [s], shape (steps,)."""
    return command_at(step_times(round(TIMES[-1] / step), step), as_real(TIMES), as_real(OMEGA))


def measure(runs: int, repeats: int, cpp: Path | None = None) -> list[Speed]:
    """Time one run and an ensemble by each program.

    Args:
        runs: Of the ensemble.
        repeats: Times that each is measured, in turns; the least counts.
        cpp: Source of a C++ program of the same model, which is built and run; None for none.

    Returns:
        One entry for each program and number of runs.

    Raises:
        InputError: the C++ program cannot be built or does not answer as it must.
    """
    with tempfile.TemporaryDirectory() as folder:
        built = None if cpp is None else build_cpp(cpp, Path(folder) / "program")
        step = choose_step(Trial.of(*_start(), RecordedCommand(TIMES, OMEGA), LINEAR_STEP)).step
        programs: list[tuple[str, int, float, Callable[[], float]]] = []
        for count in (1, runs):
            programs.append(("drftjax", count, step, _ours(count, step)))
            if built is not None:
                theirs = partial(cpp_seconds, built, count, LINEAR_STEP, TIMES[-1])
                programs.append(("C++", count, LINEAR_STEP, theirs))
        programs.append(("plain NumPy", 1, LINEAR_STEP, _numpy))
        times = [[clock() for *_, clock in programs] for _ in range(repeats)]
        return [
            Speed(name, count, dt, min(taken))
            for (name, count, dt, _), taken in zip(programs, zip(*times, strict=True), strict=True)
        ]


def table(speeds: list[Speed]) -> WholeWordTable:
    """The measured speeds, each over that of the C++ program where there is one."""
    cores = jax.device_count()
    made = WholeWordTable(
        title=f"The paper's {TIMES[-1]:g} s profile in double precision, {cores} cores"
        " (a single run uses one)"
    )
    for heading in ("program", "runs", "step", "time", "runs a second", "times real time",
                    "a step of a run", "time over C++"):  # fmt: skip
        left = heading == "program"
        made.add_column(heading, justify="left" if left else "right")
    beside = {each.runs: each.seconds for each in speeds if each.program == "C++"}
    for each in speeds:
        ratio = f"{each.seconds / beside[each.runs]:.2f}" if each.runs in beside else "-"
        made.add_row(
            each.program, f"{each.runs}", f"{1e3 * each.step:g} ms", f"{each.seconds:.3g} s",
            f"{each.per_second:.3g}", f"{each.per_second * TIMES[-1]:,.0f}",
            f"{1e6 * each.per_step:.3g} us", ratio,
        )  # fmt: skip
    return made


def _start() -> tuple[Simulator, State]:
    return Simulator(), State.at_rest(SINKAGE)


def _with_zeta(zeta: jax.Array) -> Simulator:
    return Simulator(GrouserWheel(), Terrain(ConstantZeta(zeta)))


def _ours(runs: int, step: float) -> Callable[[], float]:
    commands, every = profile(step), max(1, round(ROW / step))
    if runs == 1:
        program = eqx.filter_jit(lambda: simulate(*_start(), commands, step, every=every))
    else:
        simulators = eqx.filter_vmap(_with_zeta)(as_real(np.linspace(*ENSEMBLE_ZETA, runs)))
        states = eqx.filter_vmap(State.at_rest)(as_real(np.full(runs, SINKAGE)))
        program = lambda: simulate_ensemble(simulators, states, commands, step, every=every)  # noqa: E731
    jax.block_until_ready(program())
    return lambda: _seconds(lambda: jax.block_until_ready(program()))


def _numpy() -> float:
    omega = np.asarray(profile(LINEAR_STEP).omega)
    return _seconds(lambda: simulate_in_numpy(Simulator(), SINKAGE, omega, LINEAR_STEP))


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def build_cpp(source: Path, program: Path, real: str = "double") -> Path:
    """Build a C++ program of the model in a precision, "double" or "float"; return its path.

    Raises:
        InputError: there is no source or no g++, or it does not build.
    """
    if not source.exists():
        raise InputError(f"{source}: {missing_path(source, 'file')}")
    if not source.is_file():
        raise InputError(f"{source}: must be a C++ source file")
    if shutil.which("g++") is None:
        raise InputError(f"{source}: there is no g++ to build it, which must be installed")
    command = ["g++", *CPP_FLAGS, f"-DREAL={real}", str(source), "-o", str(program)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        raise InputError(f"{source}: g++ cannot build it with {' '.join(CPP_FLAGS)}")
    return program


def cpp_seconds(program: Path, runs: int, step: float, duration: float) -> float:
    """Time that a C++ program says that it took [s], its own start left out.

    Args:
        program: By `build_cpp`.
        runs: Runs to make.
        step: Step [s].
        duration: Of a run [s].

    Raises:
        InputError: it does not answer as it must.
    """
    words = [str(program), str(runs), str(step), str(duration)]
    told = subprocess.run(words, capture_output=True, text=True, check=False).stdout
    found = CPP_ANSWER.search(told)
    if not found:
        raise InputError(f"the C++ program answers {told[:80]!r}, must print 'steps N: S s, U us'")
    # The microseconds have more digits than the seconds.
    return float(found[3]) * 1e-6 * runs * int(found[1])
