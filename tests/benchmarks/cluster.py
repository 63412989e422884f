"""Throughput of fits on a local cluster against one process, on many short synthetic runs.

`python -m tests.benchmarks.cluster` prints the table of docs/guide/cluster.md.
One process fits the first
runs of the same files by the same function that a worker calls, and also by plain `fit`; the
largest difference between the numbers is printed too. Every process has fitted a run before its
clock starts, so that no program is compiled while it runs.
"""

import argparse
import dataclasses
import os
import platform
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import numpy as np
from rich.progress import Progress

from drftjax.cluster.connection import LocalWorkers, connect
from drftjax.cluster.pieces import LogFile
from drftjax.cluster.store import WorkStore
from drftjax.cluster.worker_process import set_up_worker
from identify.cluster.fit_options import FIT_STORE, FitOptions, ParameterSpec
from identify.cluster.lone_fits import fit_on
from identify.cluster.result_codec import decode_result, encode_result
from identify.cluster.worker import FitReply, fit_logs, fit_replies

# The step is the one that a fit takes by itself.
SETTINGS = FitOptions((ParameterSpec("terrain.zeta", None, None, None),), step=5e-4)
SANDS = 50
PROFILE = ([0.0, 0.2, 0.7, 1.0], [0.0, 0.0, 0.5, 0.5])


def write_logs(folder: Path, count: int) -> list[LogFile]:
    """Runs on fifty sands, each with noise of its own."""
    from drftjax.runlog.hdf5.api import write_run
    from tests.helpers.synthetic_runs import recorded, setup_of

    clean = [recorded(setup_of(PROFILE, zeta), noise=0.0) for zeta in np.linspace(0.6, 0.9, SANDS)]
    logs = []
    for number in range(count):
        run = clean[number % SANDS]
        random = np.random.default_rng(number)
        noisy = {
            name: getattr(run.measured, name) + 20e-6 * random.standard_normal(len(run.measured.z))
            for name in ("x", "z")
        }
        measured = dataclasses.replace(run.measured, **noisy)
        path = folder / f"run{number:04}.h5"
        write_run(path, dataclasses.replace(run, measured=measured))
        logs.append(LogFile.at(path))
    return logs


def one_process(logs: Sequence[LogFile]) -> tuple[float, list[FitReply]]:
    """Time [s] and results of logs fitted one after the other, here."""
    settings = SETTINGS.encoded()
    fit_logs(settings, [(logs[0].digest, logs[0].read())])
    begin = time.perf_counter()
    found = [fit_replies(fit_logs(settings, [(log.digest, log.read())]))[0] for log in logs]
    return time.perf_counter() - begin, found


def on_cluster(logs: Sequence[LogFile], workers: int, store: WorkStore) -> tuple[float, float]:
    """Time of start and first fits, and of the rest [s]."""
    warming, rest = logs[: 4 * workers], logs[4 * workers :]
    begin = time.perf_counter()
    with connect(LocalWorkers(workers)) as client, Progress() as bar:
        task = bar.add_task("fits", total=len(rest))
        failures = fit_on(client, warming, SETTINGS, store, lambda done, of: None)
        warm = time.perf_counter()
        failures |= fit_on(
            client, rest, SETTINGS, store, lambda done, of: bar.update(task, completed=done)
        )
        end = time.perf_counter()
    for why in failures.values():
        print(f"left out: {why}")
    return warm - begin, end - warm


def plainly(logs: Sequence[LogFile]) -> list:
    """The same logs fitted as a program of one's own would, without what makes tasks of them."""
    from drftjax.recorded.prepared_run import prepare_run
    from drftjax.runlog.hdf5.api import read_run
    from identify.fit_constant import fit
    from identify.parameters.parameter import parameter

    zeta = [parameter("zeta", shared=False)]
    runs = [prepare_run(log.path.stem, read_run(log.path), step=SETTINGS.step) for log in logs]
    return [decode_result(encode_result(fit([run], zeta))) for run in runs]


def largest_difference(found: Sequence, others: Sequence) -> float:
    """Largest relative difference of values and errors, and absolute one of simulations [m]."""
    apart = 0.0
    for ours, theirs in zip(found, others, strict=True):
        one, other = ours.run, theirs.run
        for name, value in one.values.items():
            apart = max(apart, abs(value.value / other.values[name].value - 1))
            apart = max(apart, abs(value.error / other.values[name].error - 1))
        apart = max(apart, float(np.abs(one.after - other.after).max()))
    return apart


def machine() -> str:
    """Processor, cores and load."""
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text().splitlines() if cpus.exists() else []
    model = next((line.partition(": ")[2] for line in lines if line.startswith("model name")), "")
    load = ", ".join(f"{each:.1f}" for each in os.getloadavg())
    return f"{model or platform.processor()}, {os.cpu_count()} cores, load {load} before"


def main() -> None:
    """Print the table."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--logs", type=int, default=2000)
    given.add_argument("--one", type=int, default=100, help="Logs for the one process.")
    given.add_argument("--workers", type=int, default=os.cpu_count())
    options = given.parse_args()
    print(machine(), flush=True)
    set_up_worker(SETTINGS.software)
    with tempfile.TemporaryDirectory() as folder:
        logs = write_logs(Path(folder), options.logs)
        some = logs[: options.one]
        alone, found = one_process(some)
        path = Path(folder) / "fit.store"
        with WorkStore(path, FIT_STORE, SETTINGS.plain_values()) as store:
            start, rest = on_cluster(logs, options.workers, store)
            everything = [
                decode_result(store.result(log.digest)) for log in logs if log.digest in store
            ]
            on_workers = [decode_result(store.result(log.digest)) for log in some]
        size = path.stat().st_size
        plain = plainly(some[:20])
    fitted = len(logs) - 4 * options.workers
    one, many = len(some) / alone, fitted / rest
    print("| | logs | time [s] | fits/s | ratio |\n|---|--:|--:|--:|--:|")
    print(f"| one process | {len(some)} | {alone:.1f} | {one:.2f} | 1.00 |")
    print(
        f"| cluster of {options.workers} workers | {fitted} | {rest:.1f} | {many:.2f} | "
        f"{many / one:.2f} |"
    )
    print(f"start of the cluster and its first {4 * options.workers} fits: {start:.1f} s")
    print(f"store: {size / 2**20:.1f} MiB of {len(everything)} fits")
    ends = [each.run.status for each in everything]
    print("ends:", ", ".join(f"{ends.count(end)} {end}" for end in sorted(set(ends))))
    apart = largest_difference(on_workers, [decode_result(each.result) for each in found])
    print(f"largest difference, cluster and one process, {len(some)} logs: {apart:.2g}")
    apart = largest_difference(on_workers[: len(plain)], plain)
    print(f"largest difference, cluster and plain fits, {len(plain)} logs: {apart:.2g}")


if __name__ == "__main__":
    main()
