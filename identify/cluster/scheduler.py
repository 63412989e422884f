"""Fits of many run logs on a Dask cluster, each log by itself on whichever worker is free.

A task carries a few logs as the bytes of their files, so workers need no common disk, and fits one
after the other: a batch would weigh each log by the residuals of its neighbours. What a task
brings back is appended to a store before the next is looked at. Dask gives a lost worker's tasks to
the others.
"""

import asyncio
import importlib.util
import logging
import math
import os
import re
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drftjax.common.errors import InputError
from drftjax.common.text import replace_unprintable
from identify.cluster.store import FinishedFit, FitStore
from identify.cluster.worker import FitOptions, fit_logs, fit_replies

if TYPE_CHECKING:
    from distributed import Client, Future


@dataclass(frozen=True)
class ClusterSettings:
    """Numbers of the fits on a cluster.

    Attributes:
        connect_limit: Time for a scheduler to answer [s].
        worker_limit: Time that a cluster may have no worker at all [s].
        max_log_bytes: Larger logs are not sent to a worker [bytes].
        tasks_a_worker: Tasks that wait at each worker: enough that none idles, and few are held in
            memory.
        logs_a_task: Logs of one task, at most.
        task_bytes: Bytes of the logs of one task, unless one alone is larger [bytes].
        poll_interval: Time between looks at the cluster [s].
        workers_a_core: Workers on each core of this machine, at most.
    """

    connect_limit: float = 10.0
    worker_limit: float = 60.0
    max_log_bytes: int = 256 * 2**20
    tasks_a_worker: int = 3
    logs_a_task: int = 4
    task_bytes: int = 8 * 2**20
    poll_interval: float = 1.0
    workers_a_core: int = 4


CLUSTER_SETTINGS = ClusterSettings()


_LOCAL = re.compile(r"local(?::(?P<workers>[0-9]{1,9}))?")


_TCP = re.compile(r"tcp://(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})")


Report = Callable[[int, int], None]


@dataclass(frozen=True)
class LocalWorkers:
    """A cluster of processes on this machine.

    Attributes:
        workers: How many.
    """

    workers: int


@dataclass(frozen=True)
class RemoteScheduler:
    """A cluster that runs already.

    Attributes:
        address: Its scheduler's, such as tcp://10.0.0.1:8786.
    """

    address: str


@dataclass(frozen=True)
class LogFile:
    """A run log's file.

    Attributes:
        path: Where it lies.
        digest: SHA-256 of its bytes, in hexadecimal.
    """

    path: Path
    digest: str

    @classmethod
    def at(cls, path: Path) -> "LogFile":
        """Return the log in a file.

        Raises:
            InputError: where it cannot be read.
        """
        return cls(path, _digest(_contents(path)))

    def read(self) -> bytes:
        """Return the file's bytes, if they are still those of the digest."""
        data = _contents(self.path)
        if _digest(data) != self.digest:
            raise InputError(f"{self.path}: has changed since this program was started")
        return data


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()


def _contents(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, must be a run log")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: must be an ordinary file")
        most = CLUSTER_SETTINGS.max_log_bytes
        if path.stat().st_size > most:
            raise InputError(
                f"{path}: is larger than {most // 2**20} MiB, too large to be sent to a "
                "worker; fit it without --cluster"
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(f"{path}: cannot be read ({reason})") from None


def parse_address(text: str) -> LocalWorkers | RemoteScheduler:
    """Return a cluster by its address: `local`, `local:4` or `tcp://scheduler:8786`.

    Raises:
        InputError: where it is none of these.
    """
    cores = os.cpu_count() or 1
    if found := _LOCAL.fullmatch(text):
        workers = cores if found["workers"] is None else int(found["workers"])
        most = CLUSTER_SETTINGS.workers_a_core * cores
        if not 1 <= workers <= most:
            raise InputError(
                f"--cluster {text}: the number of workers must be 1 to "
                f"{most} on this machine of {cores} cores"
            )
        return LocalWorkers(workers)
    if (found := _TCP.fullmatch(text)) and 1 <= int(found["port"]) <= 65535:
        return RemoteScheduler(text)
    raise InputError(
        f"--cluster is {text!r}, must be local, local:N with a number of workers, or "
        "tcp://scheduler:port"
    )


def require_extra() -> None:
    """Raise InputError where Dask is not installed."""
    if any(importlib.util.find_spec(name) is None for name in ("dask", "distributed")):
        raise InputError("--cluster needs Dask: in a checkout, pip install '.[cluster]'")


@contextmanager
def connect(where: LocalWorkers | RemoteScheduler) -> Iterator["Client"]:
    """Yield a client of the cluster; a local one is started, and stopped at the end.

    Raises:
        InputError: where no scheduler answers in time.
    """
    from distributed import Client, LocalCluster

    if isinstance(where, RemoteScheduler):
        _require_scheduler(where.address)
        with Client(where.address, timeout=CLUSTER_SETTINGS.connect_limit) as client:
            yield client
        return
    with ExitStack() as ends:
        with _without_interrupts():
            started = ends.enter_context(
                LocalCluster(
                    n_workers=where.workers,
                    silence_logs=logging.CRITICAL,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                )
            )
            client = ends.enter_context(Client(started))
        yield client


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block Ctrl-C, here and for good in the threads and processes that are started meanwhile.

    A terminal sends it to every process; the one that was called ends the others.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _require_scheduler(address: str) -> None:
    """Raise InputError where no scheduler answers in time; a client would wait for ever."""
    from distributed.comm.core import connect

    limit = CLUSTER_SETTINGS.connect_limit

    async def identity() -> Any:
        async with asyncio.timeout(limit):
            line = await connect(address, timeout=limit)
            try:
                await line.write({"op": "identity", "n_workers": 0, "reply": True})
                return await line.read()
            finally:
                line.abort()

    try:
        found = asyncio.run(identity())
    except Exception as problem:  # whoever is there may answer anything
        raise InputError(
            f"--cluster {address}: no Dask scheduler answers there within {limit:g} s "
            f"({_first_line(problem)})"
        ) from None
    if not isinstance(found, dict) or found.get("type") != "Scheduler":
        raise InputError(f"--cluster {address}: what answers there is no Dask scheduler")


def dashboard(client: "Client") -> str:
    """Address of the dashboard of the cluster; without bokeh there are plain pages only."""
    try:
        link = client.dashboard_link or ""
    except KeyError:  # the scheduler serves none
        return "none"
    if importlib.util.find_spec("bokeh") is None:
        return link.removesuffix("/status") + "/info/main/workers.html"
    return link


def fit_on(
    client: "Client",
    logs: Sequence[LogFile],
    settings: FitOptions,
    store: FitStore,
    report: Report,
    numbers: ClusterSettings = CLUSTER_SETTINGS,
) -> dict[str, str]:
    """Fit logs and keep every result as it comes.

    Args:
        client: Of the cluster.
        logs: What to fit; those that the store has are not fitted again.
        settings: How.
        store: Where results are kept.
        report: Called with the number of logs that are dealt with, and of workers.
        numbers: Decision numbers.

    Returns:
        Digests of logs that could not be fitted, and why.

    Raises:
        InputError: where the cluster is lost, or cannot fit at all. The store keeps what is done.
    """
    unique = {log.digest: log for log in logs if log.digest not in store}
    fits = _Fits(client, list(unique.values()), settings, store, report, numbers)
    try:
        fits.all()
    finally:
        fits.release()
    return fits.failures


Batch = list[tuple[LogFile, bytes]]


class _Fits:
    """Tasks in progress, and the failures of those that ended."""

    def __init__(
        self,
        client: "Client",
        logs: list[LogFile],
        settings: FitOptions,
        store: FitStore,
        report: Report,
        numbers: ClusterSettings,
    ):
        self._numbers = numbers
        self.failures: dict[str, str] = {}
        self._client = client
        self._logs = logs
        self._settings = settings.encoded()
        self._store = store
        self._report = report
        self._running: dict[Future, Batch] = {}
        self._dealt_with = 0
        self._workers = 0
        self._seen_worker = time.monotonic()

    def all(self) -> None:
        self._count_workers()
        batches = self._batches()
        while True:
            room = self._numbers.tasks_a_worker * max(1, self._workers) - len(self._running)
            for batch in islice(batches, max(0, room)):
                self._submit(batch)
            if not self._running:
                return
            self._report(self._dealt_with, self._workers)
            for future in self._ended():
                self._take(future)
            self._report(self._dealt_with, self._workers)
            self._count_workers()

    def release(self) -> None:
        """Let the cluster forget what is under way."""
        for future in self._running:
            with suppress(Exception):  # the cluster may be gone
                future.cancel()

    def _batches(self) -> Iterator[Batch]:
        """Yield the logs of one task each: few if there are few, so that every worker has some."""
        batch, size = [], 0
        for number, log in enumerate(self._logs):
            try:
                data = log.read()
            except InputError as problem:
                self._fail(log, str(problem))
                continue
            if batch and size + len(data) > self._numbers.task_bytes:
                yield batch
                batch, size = [], 0
            batch.append((log, data))
            size += len(data)
            left = len(self._logs) - number
            if len(batch) >= min(self._numbers.logs_a_task, left // (2 * max(1, self._workers))):
                yield batch
                batch, size = [], 0
        if batch:
            yield batch

    def _submit(self, batch: Batch) -> None:
        sent = [(log.digest, data) for log, data in batch]
        # Not pure: a key of its own, whatever the scheduler was asked before.
        future = self._client.submit(fit_logs, self._settings, sent, pure=False)
        self._running[future] = batch

    def _ended(self) -> list["Future"]:
        from distributed import wait

        with self._cluster_kept(), suppress(TimeoutError):
            wait(
                list(self._running),
                timeout=self._numbers.poll_interval,
                return_when="FIRST_COMPLETED",
            )
        return [each for each in self._running if each.status != "pending"]

    def _take(self, future: "Future") -> None:
        from distributed.scheduler import KilledWorker

        batch = self._running[future]
        with self._cluster_kept():
            try:
                encoded = future.result(timeout=self._numbers.poll_interval)
            except TimeoutError:
                return  # its worker was lost before it answered: it is computed again
            except KilledWorker:
                del self._running[future]
                if len(batch) > 1:
                    for each in batch:
                        self._submit([each])
                else:
                    self._fail(batch[0][0], "every worker that fitted it died")
                return
            except InputError:
                raise
            except ImportError as problem:
                raise InputError(
                    f"a worker of the cluster cannot load drftjax ({_first_line(problem)})"
                ) from None
        del self._running[future]
        finished = []
        for (log, _), answer in zip(batch, fit_replies(encoded), strict=True):
            if answer.failure:
                self._fail(log, answer.failure)
            else:
                values = {name: _finite(pair) for name, pair in answer.values.items()}
                finished.append(FinishedFit(log.digest, str(log.path), values, answer.result))
        self._store.append(finished)
        self._dealt_with += len(finished)

    def _fail(self, log: LogFile, why: str) -> None:
        self.failures[log.digest] = why
        self._dealt_with += 1

    def _count_workers(self) -> None:
        """Count the threads that fit; a cluster that has had none for long is given up."""
        with self._cluster_kept():
            threads: Any = self._client.nthreads()
            self._workers = sum(threads.values())
        now = time.monotonic()
        if self._workers:
            self._seen_worker = now
        elif now - self._seen_worker > (limit := self._numbers.worker_limit):
            raise InputError(f"the cluster has had no worker for {limit:g} s; {self._kept()}")

    @contextmanager
    def _cluster_kept(self) -> Iterator[None]:
        """Raise Dask's errors as one sentence."""
        from asyncio import CancelledError as Interrupted
        from concurrent.futures import CancelledError

        try:
            yield
        except (InputError, TimeoutError):
            raise
        except (CancelledError, Interrupted, Exception) as problem:
            what = f"{type(problem).__name__}: {_first_line(problem)}"
            raise InputError(f"the cluster is lost ({what}); {self._kept()}") from None

    def _kept(self) -> str:
        return f"{self._store.path} keeps the {len(self._store)} fits that are done"


def _finite(pair: tuple[float, float]) -> tuple[float | None, float | None]:
    value, error = (each if math.isfinite(each) else None for each in pair)
    return value, error


def _first_line(problem: BaseException) -> str:
    return replace_unprintable((str(problem) or type(problem).__name__).splitlines()[0])
