"""The loop's timing: a tick's work, deadlines missed, age of the readings.

    python -m tests.benchmarks.loop                                  # 100 Hz, no privileges
    python -m tests.benchmarks.loop --tick 0.001 --fifo --busy --runs 10
    python -m tests.benchmarks.loop --tick 0.001 --fifo --pty

The rig at the other end has no physics and plays the paper's trajectory, in a process of its own
with the same scheduling: a real one would not share these cores. The recorder records.

With --spread, the loop's threads may run on any core. With --bare, each run is followed by a loop
of the same period that only sleeps and spins for the run's median work: what it misses, the machine
misses.
"""

import argparse
import os
import platform
import pty
import socket
import subprocess
import sys
import tempfile
import tty
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from drftjax.common.jax_config import configure_jax

PROFILE = Path(__file__).resolve().parents[2] / "data" / "paper.toml"
BAUD = 921600


def machine() -> str:
    """Where a figure was taken."""
    model = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.partition(": ")[2] for line in lines if line.startswith("model name"))
    load = os.getloadavg()[0]
    cores = len(os.sched_getaffinity(0))
    return f"{model}, {cores} cores, {platform.system()} {platform.release()}, load {load:.1f}"


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that compute without end, at ordinary priority."""
    # They end with this program, however it ends.
    code = "import os\nwhile os.getppid() == {}:\n    for _ in range(10**6): pass"
    spin = [sys.executable, "-c", code.format(os.getpid())]
    burning = [subprocess.Popen(spin) for _ in range(processes)]
    try:
        yield
    finally:
        for each in burning:
            each.kill()
            each.wait()


def peer(descriptor: int, trajectory: Path, fifo: bool) -> subprocess.Popen:
    """Start the other end on this descriptor."""
    command = [sys.executable, "-m", "tests.benchmarks.loop_peer", str(descriptor), str(trajectory)]
    started = subprocess.Popen(command, pass_fds=[descriptor])
    if fifo:
        with suppress(OSError):
            os.sched_setscheduler(started.pid, os.SCHED_FIFO, os.sched_param(49))
    return started


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--tick", type=float, default=0.01)
    options.add_argument("--runs", type=int, default=1)
    options.add_argument("--seconds", type=float, default=24.0)
    options.add_argument("--tuner", default="step")
    options.add_argument("--fifo", action="store_true")
    options.add_argument("--spread", action="store_true")
    options.add_argument("--busy", action="store_true")
    options.add_argument("--pty", action="store_true")
    options.add_argument("--bare", action="store_true")
    given = options.parse_args()
    configure_jax()
    from hils.realtime import answer_at_once

    answer_at_once()
    from drftjax.setups.setup import read_setup
    from drftjax.setups.simulated_run import simulated_run

    setup = read_setup(PROFILE)
    truth = simulated_run(setup)
    cores = len(os.sched_getaffinity(0))
    print(machine())
    print(
        f"{1 / given.tick:g} Hz, tuner {given.tuner}, "
        f"{'SCHED_FIFO' if given.fifo else 'ordinary scheduling'}, "
        f"{f'{cores} processes that compute beside it' if given.busy else 'nothing beside it'}, "
        f"over a {'pty' if given.pty else 'socketpair'}"
    )
    # At 1 kHz one step a tick: docs/theory/integrator.md has the cost in accuracy.
    if given.tick <= 1e-3:
        setup.integrator.step = given.tick
    command = setup.command
    command.time = [time for time in command.time if time < given.seconds] + [given.seconds]
    command.omega = [*command.omega[: len(command.time) - 1], 0.0 if given.seconds >= 24 else 30.0]
    with tempfile.TemporaryDirectory() as folder:
        trajectory = Path(folder) / "trajectory.npy"
        np.save(trajectory, [truth.measured.time, truth.measured.z, truth.measured.x])
        print(
            " run  missed  skipped  work and woken late: p50, p99.9, most [ms]  a tick old at most"
        )
        for number in range(given.runs):
            with busy(cores if given.busy else 0):
                one(number, given, setup, trajectory, Path(folder))


def one(number: int, given: argparse.Namespace, setup, trajectory: Path, folder: Path) -> None:
    """Make a run and print its line."""
    from drftjax.tuning.registry import TunerSetUp
    from hils.clock import MonotonicClock
    from hils.control.limits import CommandLimits
    from hils.control.loop_config import LoopSetUp
    from hils.control.stop_request import StopRequest
    from hils.link.port_link import PortLink
    from hils.link.ports import SocketPort, open_port
    from hils.procedure.operator_prompts import UnattendedPrompts
    from hils.procedure.procedure import Procedure, run
    from hils.realtime import timely
    from hils.recording.recorder import Recorder

    numbers = {"zeta_step": 1e-3 * given.tick / 0.01} if given.tuner == "step" else {}
    loop = LoopSetUp(
        setup=setup,
        commands=CommandLimits(2.0, 0.3),
        tuner=TunerSetUp(given.tuner, numbers),
        tick=given.tick,
    )
    path = folder / f"run{number}.h5"
    with ExitStack() as opened:
        recorder = Recorder(path)
        if given.pty:
            far, near = pty.openpty()
            tty.setraw(near)
            other = peer(far, trajectory, given.fifo)
            port = open_port(os.ttyname(near), BAUD)
        else:
            here, there = socket.socketpair()
            far = there.detach()
            other = peer(far, trajectory, given.fifo)
            port = SocketPort(here)
        opened.callback(other.wait)
        opened.callback(other.kill)
        os.close(far)
        clock = MonotonicClock()
        link = PortLink(port, clock)
        opened.callback(link.close)

        def timed() -> None:
            opened.enter_context(timely(given.fifo, not given.spread))

        procedure = Procedure(loop=loop, countdown=1.0)
        report = run(
            procedure, link, clock, recorder, UnattendedPrompts(True), StopRequest(), timed
        )
    if report.loop is None:
        print(f"{number:4d}  {report.reason}")
        return
    from drftjax.runlog.hdf5.api import read_run

    online = read_run(path).online
    assert online is not None
    fresh = float((online.age[5:] <= given.tick).mean())
    loop = report.loop.statistics
    print(
        f"{number:4d}  {loop.overruns:6d}  {loop.skipped:7d}  "
        f"{_figures(loop.work_time)}  {_figures(loop.wake_delay)}  {fresh:.2%}  {report.reason}",
        flush=True,
    )
    if given.bare:
        bare(given, float(np.median(loop.work_time)))


def bare(given: argparse.Namespace, work: float) -> None:
    """The same with nothing but the machine."""
    numbers = [str(each) for each in (given.tick, given.seconds, work)]
    command = [sys.executable, "-m", "tests.benchmarks.bare_loop", *numbers]
    if given.fifo:
        command.append("--fifo")
    found = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    missed, figures = found.strip().split("  ", 1)
    print(f"bare  {missed:>6}  {'':7}  {figures}", flush=True)


def _figures(seconds: np.ndarray) -> str:
    values = np.percentile(seconds * 1e3, [50, 99.9, 100])
    return "  ".join(f"{value:.3f}" for value in values)


if __name__ == "__main__":
    main()
