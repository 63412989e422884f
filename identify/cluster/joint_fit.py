"""Fit of many run logs together on a cluster: parameters shared by all, beside each run's own."""

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from drftjax.cluster.connection import CLUSTER_SETTINGS, ClusterSettings
from drftjax.cluster.pieces import LogFile, Piece
from drftjax.cluster.store import WorkStore
from drftjax.cluster.tasks import Report, Work, work_on
from drftjax.common.errors import InputError
from drftjax.recorded.prepared_run import PreparedRun
from identify.cluster.evaluator import OnCluster
from identify.cluster.fit_options import FitOptions, fit_parameters
from identify.cluster.worker import prepare_logs
from identify.fit_constant import Progress, fit
from identify.results.result import FitResult
from identify.uncertainty.noise_model import noise_model

if TYPE_CHECKING:
    from distributed import Client


def _no_report(*_: object) -> None:
    pass


def fit_together_on(
    client: "Client",
    logs: Mapping[str, LogFile],
    settings: FitOptions,
    store: WorkStore,
    prepared: Report = _no_report,
    progress: Progress = _no_report,
    numbers: ClusterSettings = CLUSTER_SETTINGS,
) -> FitResult:
    """Fit logs together, as `identify.fit_constant.fit` does in one process.

    Args:
        client: Of the cluster.
        logs: By the names that the result gives them.
        settings: How.
        store: Where the solver's steps are kept; those that it has are not computed again.
        prepared: Called with the number of logs that are dealt with, and of workers.
        progress: Called with the stage of the fit, the solver's step and the sum of squares.
        numbers: Decision numbers.

    Returns:
        The result; logs that could not be used are among its failures.

    Raises:
        InputError: where no log can be used, or the cluster is lost. The store keeps what is done.
    """
    runs, why = _prepare_on(client, list(logs.values()), settings, prepared, numbers)
    failures = {
        name: f"{log.path}: {why[log.digest]}" for name, log in logs.items() if log.digest in why
    }
    ready = [
        replace(runs[log.digest], name=name) for name, log in logs.items() if log.digest in runs
    ]
    if not ready:
        first = next(iter(failures.values()))
        several = f"none of the {len(logs)} files can be used: " * (len(logs) > 1)
        raise InputError(several + first)
    result = fit(
        ready,
        fit_parameters(settings.encoded()),
        progress,
        noise_model(settings.noise),
        evaluator=OnCluster(client, settings, store, numbers),
    )
    return result.with_failures(failures)


def _prepare_on(
    client: "Client",
    logs: Sequence[LogFile],
    settings: FitOptions,
    report: Report,
    numbers: ClusterSettings,
) -> tuple[dict[str, PreparedRun], dict[str, str]]:
    """Return prepared runs, and why there is none, by the digests of their logs."""
    runs: dict[str, PreparedRun] = {}

    def keep(answers: Sequence[tuple[Piece, bytes]]) -> dict[str, str]:
        failures = {}
        for log, answer in answers:
            found = pickle.loads(answer)
            if isinstance(found, str):
                failures[log.digest] = found
            else:
                runs[log.digest] = found
        return failures

    work = Work(prepare_logs, settings.encoded(), keep, lambda: "no run was fitted yet")
    return runs, work_on(client, logs, work, report, numbers)
