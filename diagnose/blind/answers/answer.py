"""Answering blind sets: a diagnosis of each from its runs alone. Never opens a label."""

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context, parent_process
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from drftjax.common.errors import InputError

# A process is replaced after so many sets: the programs compiled for them keep gigabytes.
SETS_A_PROCESS = 4


# What the name of a folder begins with that is no set, or not yet.
UNFINISHED = "."


def runs_of(folder: Path) -> dict[str, list[Path]]:
    """The run logs of every set in a folder; fresh runs lie deeper and are none of them.

    Raises:
        InputError: where there are no sets.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder of sets")
    sets = {
        each.name: sorted(each.glob("*.h5"))
        for each in sorted(folder.iterdir())
        if each.is_dir() and not each.name.startswith(UNFINISHED)
    }
    sets = {name: runs for name, runs in sets.items() if runs}
    if not sets:
        raise InputError(f"{folder} holds no sets; a set is a folder of run logs")
    return sets


def answer_one(runs: list[Path]) -> dict | str:
    """The answer to one set, or why there is none."""
    from diagnose.blind.answers.answer_set import answer_set

    try:
        return answer_set(runs)
    except InputError as problem:
        return str(problem)


def answer_sets(sets: Mapping[str, list[Path]], jobs: int = 1) -> Iterator[tuple[str, dict | str]]:
    """Every set's name and answer, as it is found, or why there is none.

    Args:
        sets: The runs of each set, by its name.
        jobs: Processes to find answers in, each with its share of the cores.
    """
    if jobs == 1 and len(sets) <= SETS_A_PROCESS:
        for name, runs in sets.items():
            yield name, answer_one(runs)
        return
    waiting, found = SimpleQueue(), SimpleQueue()
    names = list(sets)
    for first in range(0, len(names), SETS_A_PROCESS):
        waiting.put(names[first : first + SETS_A_PROCESS])
    with ThreadPoolExecutor(jobs) as pool:
        workers = [pool.submit(_work, waiting, found, sets, cores) for cores in _shares(jobs)]
        try:
            for _ in sets:
                answered = found.get()
                if answered is None:
                    break
                yield answered
        finally:
            while not waiting.empty():
                waiting.get()
        for worker in workers:
            worker.result()


def _work(
    waiting: SimpleQueue, found: SimpleQueue, sets: Mapping[str, list[Path]], cores: set[int]
) -> None:
    """Answer some sets after others, each time in a fresh process; None is put on any error."""
    try:
        while not waiting.empty():
            with suppress(Empty):
                for answered in _answer_some(waiting.get_nowait(), sets, cores):
                    found.put(answered)
    except BaseException:
        found.put(None)
        raise


def _answer_some(
    names: list[str], sets: Mapping[str, list[Path]], cores: set[int]
) -> Iterator[tuple[str, dict | str]]:
    # A fresh process, as JAX's threads do not live through a fork.
    with ProcessPoolExecutor(1, get_context("spawn"), configure_helper, (cores,)) as process:
        answers = [(name, process.submit(answer_one, sets[name])) for name in names]
        for name, answer in answers:
            try:
                yield name, answer.result()
            except BrokenProcessPool:
                yield name, "the process at work on it or on one before it died; memory is short?"


def _shares(jobs: int) -> list[set[int]]:
    """The cores of each process: all of them shared out, or one by turns where there are fewer.

    Where the system does not tell (macOS), none are named, and processes share all.
    """
    if not hasattr(os, "sched_getaffinity"):
        return [set()] * jobs
    cores = sorted(os.sched_getaffinity(0))
    return [set(cores[job::jobs]) or {cores[job % len(cores)]} for job in range(jobs)]


def configure_helper(cores: set[int]) -> None:
    """Set a helping process up, on some cores or on all; it ends when its parent does."""
    Thread(target=_end_with_parent, daemon=True).start()
    if cores:
        os.sched_setaffinity(0, cores)
    configure()


def _end_with_parent() -> None:
    """Or a helper whose parent was killed would wait for its next set for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def configure() -> None:
    """Set a fresh process's JAX up as the command line's."""
    from drftjax.common.jax_config import configure_jax

    configure_jax()
