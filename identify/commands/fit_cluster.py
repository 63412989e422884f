"""`drft fit --cluster`: many run logs fitted on a Dask cluster, alone or together, with a store."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from drftjax.cluster.connection import (
    LocalWorkers,
    RemoteScheduler,
    connect,
    dashboard,
    parse_address,
    quiet_dask,
    require_extra,
)
from drftjax.cluster.pieces import LogFile
from drftjax.cluster.store import WorkStore
from drftjax.commands.options import draw_picture
from drftjax.commands.printing import say_on
from drftjax.commands.progress import progress_line
from drftjax.common.errors import InputError
from identify.cluster.fit_options import FIT_STORE, FitOptions
from identify.cluster.lone_fits import fit_on

if TYPE_CHECKING:
    from identify.results.result import FitResult

# More rows or sentences than this are in the files asingle.
MOST_ROWS = 40


MOST_SENTENCES = 20


WORST_LAST = ("converged", "poor fit", "stalled", "out of steps")


def fit_on_cluster(
    address: str,
    runs: Mapping[str, Path],
    settings: FitOptions,
    stem: Path | None,
    left_out: Mapping[str, str],
    inputs: Sequence[Path | None],
    picture: Path | None = None,
) -> None:
    """Fit runs, continue where a killed call ended, and write the usual results.

    Runs that share no parameter are fitted each by itself.

    Args:
        address: The cluster's.
        runs: Files by the names that results give them.
        settings: How they are fitted.
        stem: Of the result files; STEM.store keeps what is done.
        left_out: Files that are not among the runs, and why.
        inputs: Files and folders that the command was given.
        picture: File of a figure, whose name was checked, or None.

    Raises:
        InputError: see `fit_on` and `fit_together_on`; also where no run can be fitted.
    """
    from drftjax.results.provenance import command_provenance
    from identify.results.result import write_with_report

    where = parse_address(address)
    require_extra()
    if stem is None:
        raise InputError("--cluster keeps its results beside those of -o: give -o too")
    quiet_dask()
    console = Console()
    logs: dict[str, LogFile] = {}
    failures = dict(left_out)
    for name, path in runs.items():
        try:
            logs[name] = LogFile.at(path)
        except InputError as problem:
            failures[name] = str(problem)
    with WorkStore(
        stem.with_name(stem.name + ".store"), FIT_STORE, settings.plain_values()
    ) as store:
        together = any(each.shared for each in settings.parameters)
        fit_them = _fit_together if together else _fit_apart
        result = fit_them(console, where, logs, settings, store, failures)
    _show(console, result)
    # Not before the workers end: the parent's JAX would take an accelerator's memory from them.
    result = replace(result, provenance=command_provenance("fit", inputs))
    written = ", ".join(str(each) for each in write_with_report(result, stem))
    what = "the solver's steps" if together else "every fit"
    say_on(console, f"written: {written}; {store.path} keeps {what} for a call that goes on")
    if picture is not None:
        draw_picture(result.plot(), picture)


def _fit_together(
    console: Console,
    where: LocalWorkers | RemoteScheduler,
    logs: Mapping[str, LogFile],
    settings: FitOptions,
    store: WorkStore,
    failures: Mapping[str, str],
) -> "FitResult":
    from identify.cluster.joint_fit import fit_together_on
    from identify.design.required_speed import add_required_speeds

    if not logs:
        raise InputError(_none(failures, len(failures)))
    if len(store):
        say_on(console, f"{store.path} has {len(store)} steps of the solver, made before")
    with connect(where) as client:
        say_on(console, f"dashboard: {dashboard(client)}")
        with progress_line(console, "waiting for workers", total=len(logs)) as show:

            def prepared(dealt_with: int, workers: int) -> None:
                show(f"preparing runs on {workers} workers", dealt_with)

            def report(stage: str, number: int, loss: float) -> None:
                squares = "" if np.isnan(loss) else f", sum of squares {loss:.6g}"
                show(f"{stage}: step {number}{squares}")

            result = fit_together_on(client, logs, settings, store, prepared, report)
    return add_required_speeds(result.with_failures(failures))


def _fit_apart(
    console: Console,
    where: LocalWorkers | RemoteScheduler,
    logs: Mapping[str, LogFile],
    settings: FitOptions,
    store: WorkStore,
    failures: Mapping[str, str],
) -> "FitResult":
    failures, files = dict(failures), len(logs) + len(failures)
    todo = [log for log in logs.values() if log.digest not in store]
    if len(todo) < len(logs):
        say_on(console, f"{store.path} has {len(logs) - len(todo)} of these {files} runs")
    why = _fit(console, where, todo, settings, store) if todo else {}
    for name, log in logs.items():
        if log.digest in why:
            reason = why[log.digest]
            failures[name] = reason if str(log.path) in reason else f"{log.path}: {reason}"
    done = {name: log.digest for name, log in logs.items() if log.digest in store}
    if not done:
        raise InputError(_none(failures, files))
    return _together({name: store.result(at) for name, at in done.items()}, done, failures)


def _none(failures: Mapping[str, str], files: int) -> str:
    first = next(iter(failures.values()))
    return first if files == 1 else f"none of the {files} files can be fitted: {first}"


def _fit(
    console: Console,
    where: LocalWorkers | RemoteScheduler,
    todo: Sequence[LogFile],
    settings: FitOptions,
    store: WorkStore,
) -> dict[str, str]:
    with connect(where) as client:
        say_on(console, f"dashboard: {dashboard(client)}")
        number = len({log.digest for log in todo})
        with progress_line(console, "waiting for workers", total=number) as show:

            def report(dealt_with: int, workers: int) -> None:
                show(f"fits on {workers} workers", dealt_with)

            why = fit_on(client, todo, settings, store, report)
    say_on(console, f"dealt with {number}/{number} run logs on the cluster")
    return why


def _together(
    encoded: Mapping[str, bytes], digests: Mapping[str, str], failures: Mapping[str, str]
) -> "FitResult":
    """Return the fits of single runs as one result."""
    from identify.cluster.result_codec import decode_result
    from identify.results.findings import between_run_sentences
    from identify.results.misfit import channel_floors
    from identify.results.result import FitResult

    runs, findings = [], []
    status, steps = WORST_LAST[0], 0
    for name, each in encoded.items():
        single = decode_result(each)
        runs.append(replace(single.run, name=name))
        status = max(status, single.status, key=WORST_LAST.index)
        steps = max(steps, single.steps)
        # One run alone has no repeats; all together may.
        of_one = between_run_sentences([single.run])
        said = [
            finding.replace(digests[name], name)
            for finding in single.findings
            if finding not in of_one
        ]
        said = [text if name in text else f"{name}: {text}" for text in said]
        if single.status not in WORST_LAST[:2]:
            said.append(f"{name}: the solver is {single.status} after {single.steps} steps")
        findings += said
    return FitResult(
        shared={},
        runs=runs,
        status=status,
        steps=steps,
        failures=dict(failures),
        # Sentences on all runs come before those on each, which may be cut short.
        findings=[*between_run_sentences(runs), *findings],
        floors=channel_floors(runs),
    )


def _show(console: Console, result: "FitResult") -> None:
    if len(result.runs) <= MOST_ROWS:
        console.print(result.table())
    else:
        for line in _summary(result):
            say_on(console, line)
    for value in result.shared.values():
        say_on(console, str(value))
    if result.shared and result.status not in WORST_LAST[:2]:
        say_on(console, f"the solver is {result.status} after {result.steps} steps", "yellow")
    left_out = [f"left out: {why}" for why in result.failures.values()]
    for lines, style in ((result.findings, None), (left_out, "yellow")):
        for line in lines[:MOST_SENTENCES]:
            say_on(console, line, style)
        if len(lines) > MOST_SENTENCES:
            say_on(console, f"... and {len(lines) - MOST_SENTENCES} more such, in the JSON file")


def _summary(result: "FitResult") -> list[str]:
    """Return many runs in a few lines: quantiles of each parameter, and RMSE of all together."""
    from drftjax.recorded.observation import SHOWN

    lines = [f"{len(result.runs)} runs are fitted, {len(result.failures)} are left out"]
    for name, first in result.runs[0].values.items():
        values = np.array([run.values[name].value for run in result.runs])
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
        unit = "" if first.unit == "-" else f" {first.unit}"
        lines.append(
            f"{first.label} is {middle:.5g}{unit} in the middle run, and {low:.5g} to "
            f"{high:.5g}{unit} in nine of ten"
        )
    before, after = result.rmse(False), result.rmse()
    for channel in result.channels:
        unit, scale = SHOWN[channel]
        lines.append(
            f"{channel}: RMSE {before[channel] * scale:.3f} → {after[channel] * scale:.3f} {unit}"
        )
    return lines
