"""Requests to the operating system so that ticks come on time. None of them is required."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

MCL_CURRENT = 1


# A child does not inherit a priority: a recorder at this one would fight the loop.
RESET_ON_FORK = getattr(os, "SCHED_RESET_ON_FORK", 0)


@dataclass(frozen=True)
class RealtimeSettings:
    """Requests to the operating system.

    Attributes:
        fifo_priority: Of SCHED_FIFO, 1 to 99; the middle leaves room for the kernel's own threads
            above.
        switch_interval: Time that one thread may keep Python to itself while another waits [s].
        timer_slack: Rounding of a thread's timers [ns], by default 50000.
    """

    fifo_priority: int = 50
    switch_interval: float = 1e-4
    timer_slack: int = 1


DEFAULT_REALTIME = RealtimeSettings()


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
def timely(
    fifo: bool = True, one_core: bool = True, settings: RealtimeSettings = DEFAULT_REALTIME
) -> Iterator[list[str]]:
    """Context in which the process runs as timely as it is allowed to.

    No garbage is collected, memory stays in place, and where the system allows it the process goes
    before every ordinary one (SCHED_FIFO). Then its threads share one core: only one of them holds
    Python at a time, and handing it over to another core costs more than the rest of a short tick.

    Args:
        fifo: True to ask for SCHED_FIFO.
        one_core: True to let threads that have it share a core.
        settings: Requests.

    Yields:
        The requests that were granted, in words.
    """
    granted = ["no garbage collection"]
    with ExitStack() as undo:
        switch = sys.getswitchinterval()
        sys.setswitchinterval(settings.switch_interval)
        undo.callback(sys.setswitchinterval, switch)
        if _sharp_timers(settings.timer_slack):
            granted.append("sharp timers")
        if _lock_memory():
            granted.append("memory locked")
            undo.callback(_unlock_memory)
        if fifo and _set_fifo(undo, settings.fifo_priority):
            core = _hold_to_one_core(undo) if one_core else ""
            granted.append(f"SCHED_FIFO {settings.fifo_priority}{core}")
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


def _sharp_timers(slack: int) -> bool:
    libc = _libc()
    prctl = getattr(libc, "prctl", None)
    return prctl is not None and prctl(PR_SET_TIMERSLACK, slack, 0, 0, 0) == 0


def _lock_memory() -> bool:
    """Keep what is in memory there; not what comes later, which a small limit would refuse."""
    libc = _libc()
    mlockall = getattr(libc, "mlockall", None)
    return mlockall is not None and mlockall(MCL_CURRENT) == 0


def _unlock_memory() -> None:
    libc = _libc()
    if libc is not None:
        libc.munlockall()


def _set_fifo(undo: ExitStack, priority: int) -> bool:
    """SCHED_FIFO for every thread of this process: the loop's, and the link's that feeds it."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    done = False
    for thread in _threads():
        with suppress(OSError):
            before = os.sched_getscheduler(thread), os.sched_getparam(thread)
            param = os.sched_param(priority)
            os.sched_setscheduler(thread, os.SCHED_FIFO | RESET_ON_FORK, param)
            undo.callback(_restore_schedule, thread, *before)
            done = True
    return done


def _restore_schedule(thread: int, kind: int, param: os.sched_param) -> None:
    with suppress(OSError):  # the thread may have ended
        # Who has no privileges may not take RESET_ON_FORK away again.
        os.sched_setscheduler(thread, kind | RESET_ON_FORK, param)


def _hold_to_one_core(undo: ExitStack) -> str:
    """Hold every thread of this process to one core; which, in words."""
    if not hasattr(os, "sched_setaffinity"):
        return ""
    # The first cores answer most interrupts; the last are the slow ones on some machines.
    core = max(os.sched_getaffinity(0), key=lambda each: (_clock_rate(each), each))
    held = ""
    for thread in _threads():
        with suppress(OSError):
            before = os.sched_getaffinity(thread)
            os.sched_setaffinity(thread, {core})
            undo.callback(_restore_cores, thread, before)
            held = f" on core {core}"
    return held


def _clock_rate(core: int) -> int:
    """Highest clock rate of a core [kHz]; 0 where the system does not tell."""
    try:
        return int(Path(CLOCK_RATE.format(core)).read_text())
    except (OSError, ValueError):
        return 0


def _restore_cores(thread: int, cores: set[int]) -> None:
    with suppress(OSError):  # the thread may have ended
        os.sched_setaffinity(thread, cores)


def _threads() -> list[int]:
    try:
        return [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    except OSError:
        return [0]
