"""Threads for work over the runs of a dataset, opened once per diagnosis or evaluation."""

import os
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Self, TypeVar

import jax

Item = TypeVar("Item")
Result = TypeVar("Result")


def _threads(count: int) -> ThreadPoolExecutor:
    double = bool(jax.config.values["jax_enable_x64"])

    def begin() -> None:
        jax.enable_x64(double).__enter__()  # for as long as the thread lives

    return ThreadPoolExecutor(count, initializer=begin)


def _thread_per_core() -> ThreadPoolExecutor:
    return _threads(os.cpu_count() or 1)


def _two_per_core() -> ThreadPoolExecutor:
    return _threads(2 * (os.cpu_count() or 1))


@dataclass(frozen=True, eq=False)
class RunPool:
    """Thread pools, one nested in the other, that end with the `with` block.

        with RunPool() as pool:
            residuals = pool.map(simulate, range(len(dataset.runs)))

    JAX computes outside Python's lock, so threads use all cores. They compute in the precision of
    the thread that opens the pool, which JAX does not hand on by itself.

    Attributes:
        inner: Threads that compute, as many as there are cores.
        outer: Twice as many that only hand work to `inner` and wait for it: while some wait for a
            program, others compute.
        compiling: As many as there are cores, that compile programs.
        begun: Programs that `compiling` has begun, by their keys.
        lock: Held while `begun` is looked at.
    """

    inner: ThreadPoolExecutor = field(default_factory=_thread_per_core)
    outer: ThreadPoolExecutor = field(default_factory=_two_per_core)
    compiling: ThreadPoolExecutor = field(default_factory=_thread_per_core)
    begun: dict[Hashable, Future] = field(default_factory=dict)
    lock: Lock = field(default_factory=Lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.outer.shutdown()
        self.inner.shutdown()
        self.compiling.shutdown()

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Do `work` for every item, side by side; it must not use the pool itself."""
        return list(self.inner.map(work, items))

    def map_outer(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Do `work`, which uses `map` itself, for every item, side by side.

        Runs are of different lengths: one item at a time would leave cores idle at the end of each
        pass over the runs.
        """
        return list(self.outer.map(work, items))

    def begin(self, key: Hashable, work: Callable[[], object]) -> Future:
        """Begin to compile a program by `work`, once for each key; all wait for one."""
        with self.lock:
            if key not in self.begun:
                self.begun[key] = self.compiling.submit(work)
            return self.begun[key]
