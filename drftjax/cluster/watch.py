"""Watch over a cluster while it works: its workers counted, its errors in one sentence."""

import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from drftjax.cluster.connection import CLUSTER_SETTINGS, ClusterSettings, first_line
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, Future


class ClusterWatch:
    """Watch over one cluster.

    Attributes:
        client: Of the cluster.
        workers: Threads that work, when they were last counted.
    """

    def __init__(
        self, client: "Client", kept: Callable[[], str], numbers: ClusterSettings = CLUSTER_SETTINGS
    ):
        """Begin to watch.

        Args:
            client: Of the cluster.
            kept: Clause of the errors' sentences that says what is not lost.
            numbers: Decision numbers.
        """
        self.client = client
        self.workers = 0
        self._kept = kept
        self._numbers = numbers
        self._seen_worker = time.monotonic()

    def count_workers(self) -> None:
        """Count the threads that work; a cluster that has had none for long is given up."""
        with self.errors():
            threads: Any = self.client.nthreads()
            self.workers = sum(threads.values())
        now = time.monotonic()
        if self.workers:
            self._seen_worker = now
        elif now - self._seen_worker > (limit := self._numbers.worker_limit):
            raise InputError(f"the cluster has had no worker for {limit:g} s; {self._kept()}")

    def ended(self, running: Collection["Future"], *, every: bool = False) -> list["Future"]:
        """Return tasks that have ended, waiting a little for the first, or for every one."""
        from distributed import wait

        with self.errors(), suppress(TimeoutError):
            wait(
                list(running),
                timeout=self._numbers.poll_interval,
                return_when="ALL_COMPLETED" if every else "FIRST_COMPLETED",
            )
        return [each for each in running if each.status != "pending"]

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Raise Dask's errors as one sentence; a task that kills its workers is the caller's."""
        from asyncio import CancelledError as Interrupted
        from concurrent.futures import CancelledError

        from distributed.scheduler import KilledWorker

        try:
            yield
        except (InputError, TimeoutError, KilledWorker):
            raise
        except ImportError as problem:
            raise InputError(
                f"a worker of the cluster cannot load drftjax ({first_line(problem)})"
            ) from None
        except (CancelledError, Interrupted, Exception) as problem:
            what = f"{type(problem).__name__}: {first_line(problem)}"
            raise InputError(f"the cluster is lost ({what}); {self._kept()}") from None
