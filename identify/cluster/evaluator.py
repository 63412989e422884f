"""Evaluator on a cluster: runs of a fit of all together, simulated by workers, a chunk at a time.

The fit itself runs here. Workers simulate and differentiate; for a step of the solver each brings
its runs to their normal equations, and only these come back. They are kept in the store: a killed
call asks for no step again that it has made before.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array

from drftjax.cluster.connection import CLUSTER_SETTINGS, ClusterSettings
from drftjax.cluster.store import FinishedWork, WorkStore
from drftjax.cluster.watch import ClusterWatch
from drftjax.common.errors import InputError
from identify.cluster.chunk import condensed_rows, encode_chunk, evaluate_chunk, pass_on
from identify.cluster.fit_options import FitOptions
from identify.solver.problem import AbstractEvaluator, Problem

if TYPE_CHECKING:
    from distributed import Client, Future


@dataclass(frozen=True)
class EvaluatorSettings:
    """Numbers of the division of the runs.

    Attributes:
        most_runs: Runs in a chunk, at most: a task then lasts a second or so, and a lost one costs
            no more.
        places_held: Places whose derivatives workers hold until the fit asks for all of them, or
            has gone on: the best so far, and the last that was tried.
    """

    most_runs: int = 16
    places_held: int = 2


EVALUATOR_SETTINGS = EvaluatorSettings()


class OnCluster(AbstractEvaluator):
    """Workers of a cluster."""

    def __init__(
        self,
        client: "Client",
        settings: FitOptions,
        store: WorkStore,
        numbers: ClusterSettings = CLUSTER_SETTINGS,
        division: EvaluatorSettings = EVALUATOR_SETTINGS,
    ):
        """Begin with a fit.

        Args:
            client: Of the cluster.
            settings: Of the fit; its parameters are those of the problems.
            store: Where steps are kept.
            numbers: Numbers of the work on a cluster.
            division: Numbers of the division of the runs.
        """
        self._settings = settings.encoded()
        self._store = store
        self._numbers = numbers
        self._division = division
        self._kept = f"{store.path} keeps the steps that are done"
        self._watch = ClusterWatch(client, lambda: self._kept, numbers)
        self._problem: Problem | None = None
        self._digest = ""
        self._chunks: list[tuple[np.ndarray, Future]] = []
        self._held: dict[bytes, list[Future]] = {}
        self._size = 0

    def prediction(self, problem: Problem, shared: Array, own: Array) -> Array:
        return self._over_runs(problem, "prediction", shared, own)[0]

    def residual(self, problem: Problem, shared: Array, own: Array) -> Array:
        return self._over_runs(problem, "residual", shared, own)[0]

    def blocks(self, problem: Problem, shared: Array, own: Array) -> tuple[Array, Array]:
        residual, blocks = self._over_runs(problem, "blocks", shared, own)
        return residual, blocks

    def rows(self, problem: Problem, shared: Array, own: Array) -> tuple[Array, Array]:
        self._take(problem)
        place = _bytes_of((shared, own))
        digest = sha256(self._digest.encode() + place).hexdigest()
        if digest not in self._store:
            wholes = self._submit("blocks", shared, own)
            self._held[place] = wholes
            for old in list(self._held)[: -self._division.places_held]:
                del self._held[old]
            parts = self._gather([self._call(condensed_rows, each) for each in wholes])
            kept = [self._all_runs(part, len(own)) for part in zip(*parts, strict=True)]
            values: dict[str, tuple[float | None, float | None]] = {
                each.quantity.name: (float(each.bijector.value(at)), None)
                for each, at in zip(problem.shared, shared, strict=True)
            }
            result = msgspec.msgpack.encode([(each.shape, each.tobytes()) for each in kept])
            self._store.append([FinishedWork(digest, "all runs", values, result)])
        read = msgspec.msgpack.decode(self._store.result(digest))
        residual, blocks = (jnp.asarray(np.frombuffer(each).reshape(at)) for at, each in read)
        return residual, blocks

    def _over_runs(self, problem: Problem, what: str, shared: Array, own: Array) -> list[Array]:
        self._take(problem)
        held = self._held.get(_bytes_of((shared, own))) if what == "blocks" else None
        parts = self._gather(held or self._submit(what, shared, own))
        return [jnp.asarray(self._all_runs(p, len(own))) for p in zip(*parts, strict=True)]

    def _take(self, problem: Problem) -> None:
        """Send a problem's runs to the cluster, unless they are there."""
        if self._problem is problem:
            return
        self._watch.count_workers()
        runs = int(problem.batch.runs)
        if not self._size:
            # Of one size for the whole fit: a program is compiled for it.
            share = -(-runs // (self._numbers.tasks_a_worker * max(1, self._watch.workers)))
            self._size = min(share, self._division.most_runs)
        self._problem, self._held = problem, {}
        leaves = problem.batch.trials, problem.batch.observed, problem.noise
        kind = problem.batch.channels, problem.batch.trials.rows, problem.batch.trials.every
        self._digest = sha256(_bytes_of(leaves) + repr(kind).encode()).hexdigest()
        self._chunks = []
        for first in range(0, runs, self._size):
            # The last chunk is filled up by its last run.
            places = np.minimum(np.arange(first, first + self._size), runs - 1)
            sent = encode_chunk(problem, places.tolist())
            self._chunks.append((places, self._call(pass_on, sent)))

    def _submit(self, what: str, shared: Array, own: Array) -> list["Future"]:
        to_all, to_each = np.asarray(shared), np.asarray(own)
        return [
            self._call(evaluate_chunk, self._settings, sent, what, to_all, to_each[places])
            for places, sent in self._chunks
        ]

    def _call(self, function: Callable[..., Any], *arguments: Any) -> "Future":
        with self._watch.errors():
            # Not pure: a key of its own, whatever the scheduler was asked before.
            return self._watch.client.submit(function, *arguments, pure=False)

    def _gather(self, tasks: list["Future"]) -> list[tuple[np.ndarray, ...]]:
        """Return what all chunks' tasks bring back."""
        from distributed.scheduler import KilledWorker

        while len(self._watch.ended(tasks, every=True)) < len(tasks):
            self._watch.count_workers()
        try:
            with self._watch.errors():
                found: Any = self._watch.client.gather(tasks)
        except KilledWorker:
            raise InputError(
                f"every worker that simulated one of the chunks of {self._size} runs died; "
                "memory is short, or one of the runs cannot be simulated"
            ) from None
        except TimeoutError:
            raise InputError(f"the cluster does not answer; {self._kept}") from None
        return found

    def _all_runs(self, parts: tuple[np.ndarray, ...], runs: int) -> np.ndarray:
        """Return the chunks' parts in the batch's order; padded runs are zero."""
        whole = np.zeros((runs, *parts[0].shape[1:]))
        # Backwards, so that of a run that fills a chunk up, the first is kept.
        for (places, _), part in zip(self._chunks, parts, strict=True):
            whole[places[::-1]] = part[::-1]
        return whole


def _bytes_of(tree: Any) -> bytes:
    """Return the numbers of a tree's arrays, their kinds and shapes."""
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    return b"".join(repr((x.dtype.str, x.shape)).encode() + x.tobytes() for x in leaves)
