"""The table data/example.csv: five runs of a rig of our own whose vertical guide rubs.

Run as `python -m tests.studies.example_table`. The runs are those of `tests.studies.example_runs`,
with dry friction in the guide, written as the table of a data logger: one row for a sample, the
runs below one another, sinkage counted downward.
"""

from pathlib import Path

import numpy as np

from drftjax.common.jax_config import configure_jax
from drftjax.effects.serialization import Entry
from drftjax.runlog.record import RunLog
from tests.studies.example_runs import make

TABLE = Path(__file__).parents[2] / "data" / "example.csv"
SEED = 20261126
# Dry friction of the vertical guide [N]: 4 % of the load of 185 N.
FAULT: Entry = {"name": "vertical_coulomb", "force": 8.0}
# Name of a profile for each run; the first two and the next two repeat each other.
RUNS = ("slow_a", "slow_b", "medium", "medium", "fast")
HEADINGS = "run,t [s],speed [rpm],travel [mm],sinkage [mm]"


def lines(number: int, run: RunLog) -> list[str]:
    """Rows of one run as a logger writes them."""
    measured = run.measured
    assert measured.x is not None
    omega = np.interp(measured.time, run.command.time, run.command.omega)
    columns = zip(
        measured.time, omega * 30 / np.pi, 1e3 * measured.x, -1e3 * measured.z, strict=True
    )
    return [f"{number},{t:.2f},{rpm:.4f},{x:.3f},{z:.3f}" for t, rpm, x, z in columns]


def main() -> None:
    configure_jax()
    random = np.random.default_rng(SEED)
    rows = [HEADINGS]
    for number, name in enumerate(RUNS, 1):
        rows += lines(number, make(name, random, [FAULT]))
    TABLE.write_text("\n".join(rows) + "\n")
    print(TABLE)


if __name__ == "__main__":
    main()
