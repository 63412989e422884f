"""Fits of many run logs on a cluster, each by itself.

A task fits one log after the other: a batch would weigh each log by the residuals of its
neighbours.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from drftjax.cluster.connection import CLUSTER_SETTINGS, ClusterSettings
from drftjax.cluster.pieces import LogFile, Piece
from drftjax.cluster.store import FinishedWork, WorkStore
from drftjax.cluster.tasks import Report, Work, work_on
from identify.cluster.fit_options import FitOptions
from identify.cluster.worker import fit_logs, fit_replies

if TYPE_CHECKING:
    from distributed import Client


def fit_on(
    client: "Client",
    logs: Sequence[LogFile],
    settings: FitOptions,
    store: WorkStore,
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

    def keep(answers: Sequence[tuple[Piece, bytes]]) -> dict[str, str]:
        replies = fit_replies([answer for _, answer in answers])
        finished, failures = [], {}
        for (log, _), reply in zip(answers, replies, strict=True):
            if reply.failure:
                failures[log.digest] = reply.failure
                continue
            values = {name: _finite(pair) for name, pair in reply.values.items()}
            finished.append(FinishedWork(log.digest, str(log.path), values, reply.result))
        store.append(finished)
        return failures

    def kept() -> str:
        return f"{store.path} keeps the {len(store)} fits that are done"

    todo = [log for log in logs if log.digest not in store]
    return work_on(client, todo, Work(fit_logs, settings.encoded(), keep, kept), report, numbers)


def _finite(pair: tuple[float, float]) -> tuple[float | None, float | None]:
    value, error = (each if math.isfinite(each) else None for each in pair)
    return value, error
