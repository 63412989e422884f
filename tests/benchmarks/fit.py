"""How long a fit of one rig's runs takes: zeta of each run, lambda shared.

    python -m tests.benchmarks.fit [FOLDER ...]

Each folder holds the run logs of one rig. The first folder is fitted twice, so that its second
time is without compilation; a folder after it shows whether another batch compiles anything again.
"""

import sys
import time
from pathlib import Path

FOLDERS = ("../shared/blind/single_practice/set_11", "../shared/blind/single_practice/set_12")
COMPILED = "/jax/core/compile/backend_compile_duration"


def main() -> None:
    from drftjax.common.jax_config import configure_jax

    configure_jax(devices=_cores())
    import jax
    from rich.console import Console
    from rich.table import Table

    from drftjax.recorded.prepared_run import prepare_runs
    from identify.fit_constant import fit
    from identify.parameters.parameter import parameter

    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, _, **__: compiled.append(event) if event == COMPILED else None
    )
    folders = [Path(each) for each in sys.argv[1:] or FOLDERS]
    table = Table("runs of", "runs", "time, s", "solver steps", "programs compiled", "status")
    for folder in (folders[0], *folders):
        candidates = prepare_runs(sorted(folder.glob("*.h5")))
        compiled.clear()
        steps = []
        begun = time.perf_counter()
        found = fit(
            candidates,
            [parameter("zeta", shared=False), parameter("lambda", shared=True)],
            progress=lambda stage, step, loss, steps=steps: steps.append(stage),
        )
        seconds = time.perf_counter() - begun
        cells = len(candidates), f"{seconds:.1f}", len(steps), len(compiled), found.status
        table.add_row(folder.name, *map(str, cells))
    console = Console(width=100)
    console.print(f"{_cores()} cores")
    console.print(table)


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0))


if __name__ == "__main__":
    main()
