"""How long a diagnosis of one rig's runs takes, against the whole catalogue.

    python -m tests.benchmarks.diagnosis [FOLDER ...]

Each folder holds the run logs of one rig, and is diagnosed twice. The very first time is a cold
start, with nothing compiled and no compiled program read from a file; another rig's first time
compiles what the ones before did not need, and the second time of each nothing. The last column
compares with simulating the same runs once by the reference model, in the same process.
"""

import itertools
import os
import sys
import time
from pathlib import Path

FOLDERS = ("../shared/blind/single_practice/set_05", "../shared/blind/single_practice/set_02")


def main() -> None:
    from drftjax.common.jax_config import configure_jax

    configure_jax()
    import jax

    jax.config.update("jax_enable_compilation_cache", False)
    from rich.console import Console
    from rich.table import Table

    from diagnose.api import effects_among, possible_effects
    from diagnose.dataset import RigDataset
    from diagnose.pipeline import diagnose
    from drftjax.recorded.prepared_run import prepare_runs

    folders = [Path(each) for each in sys.argv[1:] or FOLDERS]
    table = Table("runs of", "verdict", "time, s", "CPU time, s", "of simulating them once")
    for folder, when in itertools.product(folders, ("the first time", "again")):
        begun, worked = time.perf_counter(), time.process_time()
        runs = prepare_runs(sorted(folder.glob("*.h5")))
        effects = possible_effects(runs, effects_among(None))
        found = diagnose(RigDataset.of(runs), effects)
        seconds, work = time.perf_counter() - begun, time.process_time() - worked
        ratio = f"{seconds / _simulated_once(found.dataset):.0f}"
        verdict = " + ".join(found.verdict)
        table.add_row(f"{folder.name}, {when}", verdict, f"{seconds:.0f}", f"{work:.0f}", ratio)
    console = Console(width=100)
    console.print(f"{len(os.sched_getaffinity(0))} cores, {len(effects)} effects")
    console.print(table)


def _simulated_once(dataset) -> float:
    """Seconds that the runs take one after another, compiled; the shortest of a few."""
    import numpy as np

    from diagnose.model.augmented_model import AugmentedModel

    def once() -> float:
        begun = time.perf_counter()
        for run in range(len(dataset.runs)):
            dataset.prediction(AugmentedModel(), run, 0.0, np.zeros(0))
        return time.perf_counter() - begun

    return min(once() for _ in range(3))


if __name__ == "__main__":
    main()
