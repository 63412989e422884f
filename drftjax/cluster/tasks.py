"""Work on many pieces on a Dask cluster, each by itself on whichever worker is free.

A task carries a few pieces as bytes, so workers need no common disk. What a task brings back is
kept before the next is looked at. Dask gives a lost worker's tasks to the others.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from drftjax.cluster.connection import CLUSTER_SETTINGS, ClusterSettings
from drftjax.cluster.pieces import Piece
from drftjax.cluster.watch import ClusterWatch
from drftjax.common.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, Future

Report = Callable[[int, int], None]


@dataclass(frozen=True)
class Work:
    """Work of one kind.

    Attributes:
        function: Function of the settings and of pieces (digest and bytes of each) that a worker
            calls; it returns an answer for each.
        settings: Its settings, encoded.
        keep: Keeps a task's answers, each with its piece; returns why there is none, by digest.
        kept: Clause that says what is not lost with the cluster.
    """

    function: Callable[[bytes, Sequence[tuple[str, bytes]]], list[bytes]]
    settings: bytes
    keep: Callable[[Sequence[tuple[Piece, bytes]]], dict[str, str]]
    kept: Callable[[], str]


def work_on(
    client: "Client",
    pieces: Sequence[Piece],
    work: Work,
    report: Report,
    numbers: ClusterSettings = CLUSTER_SETTINGS,
) -> dict[str, str]:
    """Do the work of all pieces and keep every answer as it comes.

    Args:
        client: Of the cluster.
        pieces: The pieces; those of one digest are done once.
        work: What is done, and where its answers go.
        report: Called with the number of pieces that are dealt with, and of workers.
        numbers: Decision numbers.

    Returns:
        Digests of pieces without an answer, and why.

    Raises:
        InputError: where the cluster is lost, or cannot do the work at all.
    """
    unique = {each.digest: each for each in pieces}
    tasks = _Tasks(client, list(unique.values()), work, report, numbers)
    try:
        tasks.all()
    finally:
        tasks.release()
    return tasks.failures


Batch = list[tuple[Piece, bytes]]


class _Tasks:
    """Tasks in progress, and the failures of those that ended."""

    def __init__(
        self,
        client: "Client",
        pieces: list[Piece],
        work: Work,
        report: Report,
        numbers: ClusterSettings,
    ):
        self._numbers = numbers
        self.failures: dict[str, str] = {}
        self._watch = ClusterWatch(client, work.kept, numbers)
        self._pieces = pieces
        self._work = work
        self._report = report
        self._running: dict[Future, Batch] = {}
        self._dealt_with = 0

    def all(self) -> None:
        self._watch.count_workers()
        batches = self._batches()
        while True:
            workers = self._watch.workers
            room = self._numbers.tasks_a_worker * max(1, workers) - len(self._running)
            for batch in islice(batches, max(0, room)):
                self._submit(batch)
            if not self._running:
                return
            self._report(self._dealt_with, workers)
            for future in self._watch.ended(self._running):
                self._take(future)
            self._report(self._dealt_with, workers)
            self._watch.count_workers()

    def release(self) -> None:
        """Let the cluster forget what is under way."""
        for future in self._running:
            with suppress(Exception):  # the cluster may be gone
                future.cancel()

    def _batches(self) -> Iterator[Batch]:
        """Yield the pieces of one task each: few if there are few, so that each worker has some."""
        batch, size = [], 0
        for number, piece in enumerate(self._pieces):
            try:
                data = piece.read()
            except InputError as problem:
                self._fail(piece, str(problem))
                continue
            if batch and size + len(data) > self._numbers.task_bytes:
                yield batch
                batch, size = [], 0
            batch.append((piece, data))
            size += len(data)
            share = (len(self._pieces) - number) // (2 * max(1, self._watch.workers))
            if len(batch) >= min(self._numbers.pieces_a_task, share):
                yield batch
                batch, size = [], 0
        if batch:
            yield batch

    def _submit(self, batch: Batch) -> None:
        sent = [(piece.digest, data) for piece, data in batch]
        # Not pure: a key of its own, whatever the scheduler was asked before.
        future = self._watch.client.submit(
            self._work.function, self._work.settings, sent, pure=False
        )
        self._running[future] = batch

    def _take(self, future: "Future") -> None:
        from distributed.scheduler import KilledWorker

        batch = self._running[future]
        try:
            with self._watch.errors():
                answers = future.result(timeout=self._numbers.poll_interval)
        except TimeoutError:
            return  # its worker was lost before it answered: it is computed again
        except KilledWorker:
            del self._running[future]
            if len(batch) > 1:
                for each in batch:
                    self._submit([each])
            else:
                self._fail(batch[0][0], "every worker that had it died")
            return
        del self._running[future]
        pieces = [piece for piece, _ in batch]
        self.failures |= self._work.keep(list(zip(pieces, answers, strict=True)))
        self._dealt_with += len(batch)

    def _fail(self, piece: Piece, why: str) -> None:
        self.failures[piece.digest] = why
        self._dealt_with += 1
