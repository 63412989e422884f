"""Connection with a Dask cluster: one of processes on this machine, or one that runs already."""

import asyncio
import importlib.util
import logging
import os
import re
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drftjax.common.errors import InputError
from drftjax.common.text import replace_unprintable

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class ClusterSettings:
    """Numbers of the work on a cluster.

    Attributes:
        connect_limit: Time for a scheduler to answer [s].
        worker_limit: Time that a cluster may have no worker at all [s].
        max_bytes: A larger piece of work is not sent to a worker [bytes].
        tasks_a_worker: Tasks that wait at each worker: enough that none idles, and few are held in
            memory.
        pieces_a_task: Pieces of work in one task, at most.
        task_bytes: Bytes of the pieces of one task, unless one alone is larger [bytes].
        poll_interval: Time between looks at the cluster [s].
        workers_a_core: Workers on each core of this machine, at most.
    """

    connect_limit: float = 10.0
    worker_limit: float = 60.0
    max_bytes: int = 256 * 2**20
    tasks_a_worker: int = 3
    pieces_a_task: int = 4
    task_bytes: int = 8 * 2**20
    poll_interval: float = 1.0
    workers_a_core: int = 4


CLUSTER_SETTINGS = ClusterSettings()


_LOCAL = re.compile(r"local(?::(?P<workers>[0-9]{1,9}))?")


_TCP = re.compile(r"tcp://(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})")


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
            f"({first_line(problem)})"
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


def quiet_dask() -> None:
    """Let Dask write no log: the count of workers shows a killed one."""
    for name in ("distributed", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def first_line(problem: BaseException) -> str:
    """Return an error's message in one line, or its kind where it has none."""
    return replace_unprintable((str(problem) or type(problem).__name__).splitlines()[0])
