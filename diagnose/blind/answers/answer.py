"""Diagnose blind sets from their runs alone, in worker processes; never opens a label.

Imports no JAX itself: `configure` sets it up first, in each process.
"""

import gc
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context, parent_process
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from drftjax.common.errors import InputError, require_input_folder
from drftjax.common.jax_config import ALLOCATIONS_BETWEEN_COLLECTIONS

# Sets after which a process is replaced: the programs compiled for them take gigabytes.
SETS_PER_PROCESS = 4

# First character in the name of a folder that is no set, or not yet.
UNFINISHED = "."


# Folders of a set of kind change: the runs of now, and those of the same rig before.
NOW, BEFORE = "now", "before"


def runs_of(folder: Path) -> dict[str, list[Path]]:
    """Run logs of every set in a folder, by its name; fresh runs, in a folder deeper, are excluded.

    Of a set of kind change, the runs in its folders `now` and `before`.

    Raises:
        InputError: There are no sets.
    """
    require_input_folder(folder, "sets of runs")
    sets = {
        each.name: runs_of_set(each)
        for each in sorted(folder.iterdir())
        if each.is_dir() and not each.name.startswith(UNFINISHED)
    }
    sets = {name: runs for name, runs in sets.items() if runs}
    if not sets:
        raise InputError(f"{folder} holds no sets; a set is a folder of run logs")
    return sets


def runs_of_set(folder: Path) -> list[Path]:
    """Run logs of one set; of one of kind change, those of now first."""
    sides = [sorted((folder / side).glob("*.h5")) for side in (NOW, BEFORE)]
    return [*sides[0], *sides[1]] if all(sides) else sorted(folder.glob("*.h5"))


def folder_of(runs: Sequence[Path]) -> Path:
    """Folder of the set that these runs are of."""
    parent = runs[0].parent
    return parent.parent if {each.parent.name for each in runs} == {NOW, BEFORE} else parent


def answer_one(runs: list[Path]) -> dict | str:
    """Diagnose one set: its answer, or the reason why there is none."""
    from diagnose.blind.answers.answer_set import answer_set

    try:
        return answer_set(runs)
    except InputError as problem:
        return str(problem)


def answer_sets(sets: Mapping[str, list[Path]], jobs: int = 1) -> Iterator[tuple[str, dict | str]]:
    """Diagnose sets.

    Args:
        sets: Run logs of each set, by its name.
        jobs: Number of processes, each with its share of the cores.

    Yields:
        Each set's name, with its answer or the reason why there is none, as they become known.
    """
    if jobs == 1 and len(sets) <= SETS_PER_PROCESS:
        for name, runs in sets.items():
            yield name, answer_one(runs)
        return
    waiting, answers = SimpleQueue(), SimpleQueue()
    names = list(sets)
    for first in range(0, len(names), SETS_PER_PROCESS):
        waiting.put(names[first : first + SETS_PER_PROCESS])
    with ThreadPoolExecutor(jobs) as pool:
        workers = [
            pool.submit(_work, waiting, answers, sets, cores) for cores in _core_shares(jobs)
        ]
        try:
            for _ in sets:
                answer = answers.get()
                if answer is None:
                    break
                yield answer
        finally:
            while not waiting.empty():
                waiting.get()
        for worker in workers:
            worker.result()


def _work(
    waiting: SimpleQueue, answers: SimpleQueue, sets: Mapping[str, list[Path]], cores: set[int]
) -> None:
    """Diagnose batches of sets, each in a fresh process; puts None on any error."""
    try:
        while not waiting.empty():
            with suppress(Empty):
                for answer in _answer_batch(waiting.get_nowait(), sets, cores):
                    answers.put(answer)
    except BaseException:
        answers.put(None)
        raise


def _answer_batch(
    names: list[str], sets: Mapping[str, list[Path]], cores: set[int]
) -> Iterator[tuple[str, dict | str]]:
    # A fresh process, as the threads of JAX do not survive a fork.
    with ProcessPoolExecutor(1, get_context("spawn"), configure_helper, (cores,)) as process:
        answers = [(name, process.submit(answer_one, sets[name])) for name in names]
        for name, answer in answers:
            try:
                yield name, answer.result()
            except BrokenProcessPool:
                yield name, "the process at work on it or on one before it died; memory is short?"


def _core_shares(jobs: int) -> list[set[int]]:
    """Cores of each process: equal shares, or one each in turn if there are fewer cores.

    Empty where the system does not list them (macOS): then the processes share all.
    """
    if not hasattr(os, "sched_getaffinity"):
        return [set()] * jobs
    cores = sorted(os.sched_getaffinity(0))
    return [set(cores[job::jobs]) or {cores[job % len(cores)]} for job in range(jobs)]


def configure_helper(cores: set[int]) -> None:
    """Set up a worker process on these cores, or on all if none; it ends when its parent does."""
    Thread(target=_end_with_parent, daemon=True).start()
    if cores:
        os.sched_setaffinity(0, cores)
    gc.set_threshold(ALLOCATIONS_BETWEEN_COLLECTIONS)
    configure()


def _end_with_parent() -> None:
    """End this process when its parent does, however that ends."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def configure() -> None:
    """Set up JAX in a fresh process as the command line does."""
    from drftjax.common.jax_config import configure_jax

    configure_jax()
