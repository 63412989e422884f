"""Requests to the operating system so that ticks come on time. None of them is required."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

MCL_CURRENT = 1


# Priorities from 1 to 99; the middle leaves room for the kernel's own threads above.
FIFO_PRIORITY = 50


# A child does not inherit a priority: a recorder at this one would fight the loop.
RESET_ON_FORK = getattr(os, "SCHED_RESET_ON_FORK", 0)


# How long one thread may keep Python to itself while another waits [s].
SWITCH_INTERVAL = 1e-4


# Timers of a thread are rounded up by this much [ns], by default 50000.
TIMER_SLACK = 1


PR_SET_TIMERSLACK = 29


CLOCK_RATE = "/sys/devices/system/cpu/cpu{}/cpufreq/cpuinfo_max_freq"


def answer_at_once() -> None:
    """Let JAX compute in the calling thread: half the time of a small step.

    Call it before JAX's first computation. XLA sizes its pool of threads by NPROC; a step is too
    short to be shared, and handing it to a pool and back costs as much as the step.
    """
    os.environ.setdefault("NPROC", "1")
    import jax

    jax.config.update("jax_cpu_enable_async_dispatch", False)


@contextmanager
def timely(fifo: bool = True, one_core: bool = True) -> Iterator[list[str]]:
    """Context in which the process runs as timely as it is allowed to.

    No garbage is collected, memory stays in place, and where the system allows it the process goes
    before every ordinary one (SCHED_FIFO). Then its threads share one core: only one of them holds
    Python at a time, and handing it over to another core costs more than the rest of a short tick.

    Args:
        fifo: Whether to ask for SCHED_FIFO.
        one_core: Whether threads that have it share a core.

    Yields:
        What was granted, in words.
    """
    granted = ["no garbage collection"]
    with ExitStack() as undo:
        switch = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL)
        undo.callback(sys.setswitchinterval, switch)
        if _sharp_timers():
            granted.append("sharp timers")
        if _locked():
            granted.append("memory locked")
            undo.callback(_unlocked)
        if fifo and _first_in(undo):
            core = _on_one_core(undo) if one_core else ""
            granted.append(f"SCHED_FIFO {FIFO_PRIORITY}{core}")
        gc.collect()
        gc.freeze()
        gc.disable()
        undo.callback(gc.enable)
        undo.callback(gc.unfreeze)
        yield granted


def _libc() -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(None, use_errno=True)
    except (OSError, TypeError):  # no C library of that kind on this system
        return None


def _sharp_timers() -> bool:
    libc = _libc()
    prctl = getattr(libc, "prctl", None)
    return prctl is not None and prctl(PR_SET_TIMERSLACK, TIMER_SLACK, 0, 0, 0) == 0


def _locked() -> bool:
    """Keep what is in memory there; not what comes later, which a small limit would refuse."""
    libc = _libc()
    mlockall = getattr(libc, "mlockall", None)
    return mlockall is not None and mlockall(MCL_CURRENT) == 0


def _unlocked() -> None:
    libc = _libc()
    if libc is not None:
        libc.munlockall()


def _first_in(undo: ExitStack) -> bool:
    """SCHED_FIFO for every thread of this process: the loop's, and the link's that feeds it."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    done = False
    for thread in _threads():
        with suppress(OSError):
            before = os.sched_getscheduler(thread), os.sched_getparam(thread)
            param = os.sched_param(FIFO_PRIORITY)
            os.sched_setscheduler(thread, os.SCHED_FIFO | RESET_ON_FORK, param)
            undo.callback(_restore, thread, *before)
            done = True
    return done


def _restore(thread: int, kind: int, param: os.sched_param) -> None:
    with suppress(OSError):  # the thread may have ended
        # Who has no privileges may not take RESET_ON_FORK away again.
        os.sched_setscheduler(thread, kind | RESET_ON_FORK, param)


def _on_one_core(undo: ExitStack) -> str:
    """Hold every thread of this process to one core; which, in words."""
    if not hasattr(os, "sched_setaffinity"):
        return ""
    # The first cores answer most interrupts; the last are the slow ones on some machines.
    core = max(os.sched_getaffinity(0), key=lambda each: (_pace(each), each))
    held = ""
    for thread in _threads():
        with suppress(OSError):
            before = os.sched_getaffinity(thread)
            os.sched_setaffinity(thread, {core})
            undo.callback(_let_go, thread, before)
            held = f" on core {core}"
    return held


def _pace(core: int) -> int:
    """Highest clock rate of a core [kHz]; 0 where the system does not tell."""
    try:
        return int(Path(CLOCK_RATE.format(core)).read_text())
    except (OSError, ValueError):
        return 0


def _let_go(thread: int, cores: set[int]) -> None:
    with suppress(OSError):  # the thread may have ended
        os.sched_setaffinity(thread, cores)


def _threads() -> list[int]:
    try:
        return [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    except OSError:
        return [0]
