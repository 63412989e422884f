"""Speed-up of a fit with a shared lambda by a second worker, and its equality with one process.

`python -m tests.benchmarks.cluster_joint` prints the table of docs/guide/cluster.md: 2,000 short
synthetic runs, lambda shared, zeta each run's own. Every worker has fitted some of the runs before
the clock starts, so that no program is compiled while it runs. Times that processes computed do not
hang on what else the machine did.
"""

import argparse
import dataclasses
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

import numpy as np

from drftjax.cluster.connection import CLUSTER_SETTINGS, LocalWorkers, connect, quiet_dask
from drftjax.cluster.pieces import LogFile
from drftjax.cluster.store import WorkStore
from drftjax.cluster.worker_process import set_up_worker
from identify.cluster.evaluator import EVALUATOR_SETTINGS
from identify.cluster.fit_options import FIT_STORE, FitOptions, ParameterSpec
from tests.benchmarks.cluster import machine

LAMBDA = ParameterSpec("terrain.inertial_coefficient", (-20.0, 50.0), None, None, shared=True)
ZETA = ParameterSpec("terrain.zeta", None, None, None)
# The step is near the one that a fit takes by itself.
SETTINGS = FitOptions((LAMBDA, ZETA), step=5e-4)
SANDS = 50
# A fast wheel tells lambda.
PROFILES = (
    ([0.0, 0.1, 0.4, 0.7], [0.0, 0.0, 4.0, 4.0]),
    ([0.0, 0.1, 0.5, 0.6], [0.0, 0.0, 5.0, 5.0]),
)
NOISE = 20e-6


def write_logs(folder: Path, count: int) -> dict[str, LogFile]:
    """Runs of two commands on fifty sands, each with noise of its own."""
    from drftjax.runlog.hdf5.api import write_run
    from tests.helpers.synthetic_runs import recorded, setup_of

    clean = [
        recorded(setup_of(PROFILES[number % 2], zeta), noise=0.0)
        for number, zeta in enumerate(np.linspace(0.65, 0.85, SANDS))
    ]
    logs = {}
    for number in range(count):
        run = clean[number % SANDS]
        random = np.random.default_rng(number)
        noisy = {
            name: getattr(run.measured, name) + NOISE * random.standard_normal(len(run.measured.z))
            for name in ("x", "z")
        }
        measured = dataclasses.replace(run.measured, **noisy)
        path = folder / f"run{number:04}.h5"
        write_run(path, dataclasses.replace(run, measured=measured))
        logs[path.stem] = LogFile.at(path)
    return logs


def on_cluster(logs: Mapping[str, LogFile], workers: int, folder: Path) -> tuple:
    """Time [s], times that the workers and this process computed [s], result, store's bytes."""
    from identify.cluster.joint_fit import fit_together_on

    fewest = CLUSTER_SETTINGS.tasks_a_worker * workers * EVALUATOR_SETTINGS.most_runs
    warming = dict(list(logs.items())[:fewest])
    path, plain = folder / f"of{workers}.store", SETTINGS.plain_values()
    with (
        connect(LocalWorkers(workers)) as client,
        WorkStore(folder / f"warm{workers}.store", FIT_STORE, plain) as warm,
        WorkStore(path, FIT_STORE, plain) as store,
    ):
        fit_together_on(client, warming, SETTINGS, warm)
        begin, here = time.perf_counter(), time.process_time()
        there = sum(client.run(time.process_time).values())
        result = fit_together_on(client, logs, SETTINGS, store)
        there = sum(client.run(time.process_time).values()) - there
        end, here = time.perf_counter(), time.process_time() - here
    return end - begin, there, here, result, path.stat().st_size


def in_one_process(logs: Mapping[str, LogFile]) -> tuple:
    """Time [s] and result of plain `fit`, on one device; it compiles its programs meanwhile."""
    from drftjax.recorded.prepared_run import prepare_run
    from drftjax.runlog.hdf5.api import read_run
    from identify.cluster.fit_options import fit_parameters
    from identify.fit_constant import fit

    begin = time.perf_counter()
    runs = [prepare_run(name, read_run(log.path), step=SETTINGS.step) for name, log in logs.items()]
    result = fit(runs, fit_parameters(SETTINGS.encoded()))
    return time.perf_counter() - begin, result


def largest_difference(ours, theirs) -> tuple[float, float]:
    """Largest relative differences of values and of errors."""
    pairs = [(ours.values[label], each) for label, each in theirs.values.items()]
    return (
        max(abs(one.value / other.value - 1) for one, other in pairs),
        max(abs(one.error / other.error - 1) for one, other in pairs),
    )


def main() -> None:
    """Print the table."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--logs", type=int, default=2000)
    given.add_argument("--workers", type=int, default=os.cpu_count())
    given.add_argument("--without-one", action="store_true", help="Leave the one process out.")
    options = given.parse_args()
    print(machine(), flush=True)
    quiet_dask()
    set_up_worker(SETTINGS.software)
    print("| | runs | time [s] | ratio | workers computed [s] | the call computed [s] |")
    print("|---|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        logs = write_logs(Path(folder), options.logs)
        times, results = [], []
        for workers in (1, options.workers):
            whole, there, here, result, size = on_cluster(logs, workers, Path(folder))
            times.append(whole)
            results.append(result)
            print(
                f"| workers: {workers} | {len(logs)} | {whole:.1f} | {times[0] / whole:.2f} | "
                f"{there:.1f} | {here:.1f} |",
                flush=True,
            )
        if not options.without_one:
            whole, alone = in_one_process(logs)
            results.append(alone)
            print(f"| one process | {len(logs)} | {whole:.1f} | {times[0] / whole:.2f} | | |")
    print(f"load after: {', '.join(f'{each:.1f}' for each in os.getloadavg())}")
    last = results[-1]
    print(f"{last.status} after {last.steps} steps; {'; '.join(map(str, last.shared.values()))}")
    print(f"store: {size / 2**20:.1f} MiB")
    for name, result in zip(("one worker", f"{options.workers} workers"), results, strict=False):
        value, error = largest_difference(result, last)
        print(f"largest difference of {name} from the last line: {value:.2g}, errors {error:.2g}")


if __name__ == "__main__":
    main()
