"""Fits of practice sets without the effect that the label names, beside a fit that has it.

    python -m tests.studies.practice_fits FOLDER [--sets set_01 ...] [-o FILE.json]

Every run has a zeta of its own, lambda is shared. The zeta of a fit that has the labelled effects,
every number of them fitted too, stands for the truth; its largest residual, in noise floors, says
how well it may. "Before" are first weights by the instruments' noise, "after" today's.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.jax_config import configure_jax
from drftjax.effects.catalogue import catalogue, field_metadata
from drftjax.recorded.prepared_run import prepare_runs
from drftjax.runlog.hdf5.api import read_run
from identify.fit_constant import FIT_SETTINGS, fit
from identify.parameters.parameter import parameter
from identify.results.misfit import in_floors
from identify.results.result import FitResult
from tests.studies.wrong_models import SMALL_BIAS, SMALL_ERRORS

LAMBDA = parameter("lambda", shared=True)
ZETA = parameter("zeta", shared=False)
NOISE_FIRST = replace(FIT_SETTINGS, model_shares={})


def fitted(folder: Path, effects: list[str], settings=FIT_SETTINGS) -> FitResult:
    """Fit a set's runs with every number of these effects free."""
    numbers = [f"{name}.{n}" for name in effects for n in field_metadata(catalogue()[name])]
    runs = {path.stem: read_run(path) for path in sorted(folder.glob("*.h5"))}
    shared = [LAMBDA, *(parameter(each, shared=True) for each in numbers)]
    return fit(prepare_runs(runs, fitted=numbers), [*shared, ZETA], settings=settings)


def zetas(result: FitResult) -> tuple[np.ndarray, np.ndarray]:
    each = [run.values["terrain.zeta"] for run in result.runs]
    return np.array([v.value for v in each]), np.array([v.error for v in each])


def compared(folder: Path, label: list[str]) -> dict:
    """Bias of zeta, before and after, of one set [-]."""
    listed = [name for name in label if name in catalogue()]
    found: dict = {"set": folder.name, "label": label}
    truth = None
    if len(listed) == len(label):
        reference = fitted(folder, listed)
        floors = [in_floors(run, reference.floors) for run in reference.runs]
        found["floors"] = max(max(each.values()) for each in floors)
        truth, _ = zetas(reference)
    for when, settings in (("before", NOISE_FIRST), ("after", FIT_SETTINGS)):
        result = fitted(folder, [], settings)
        value, error = zetas(result)
        entry = {"status": result.status, "error": float(np.sqrt(np.mean((error / value) ** 2)))}
        if truth is not None:
            bias = value / truth - 1
            told = error / truth
            small = (np.abs(bias) < SMALL_BIAS) | (np.abs(bias) < SMALL_ERRORS * told)
            entry |= {"bias": float(np.sqrt(np.mean(bias**2))), "small": float(small.mean())}
        found[when] = entry
    return found


def table(sets: list[dict]) -> Table:
    table = Table("set", "label", "floors", title="zeta without the labelled effect")
    for when in ("before", "after"):
        for title in ("off [%]", "told [%]", "small", "status"):
            table.add_column(f"{when}: {title}")
    for each in sets:
        cells = []
        for when in ("before", "after"):
            one = each[when]
            cells += [
                f"{100 * one['bias']:.1f}" if "bias" in one else "-",
                f"{100 * one['error']:.2g}",
                f"{one['small']:.0%}" if "bias" in one else "-",
                one["status"],
            ]
        table.add_row(
            each["set"],
            ", ".join(each["label"]),
            f"{each['floors']:.2g}" if "floors" in each else "-",
            *cells,
        )
    known = [each for each in sets if "bias" in each["after"]]
    if known:
        shares = ", ".join(
            f"{when} {np.mean([each[when]['small'] for each in known]):.0%}"
            for when in ("before", "after")
        )
        table.caption = f"small in: {shares} of the zetas of {len(known)} sets"
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="practice sets, with labels.json")
    parser.add_argument("--sets", nargs="*")
    parser.add_argument("-o", "--output", type=Path, help="write the figures here, as JSON")
    given = parser.parse_args()
    configure_jax()
    labels = json.loads((given.folder / "labels.json").read_text())
    sets = []
    for name in given.sets or sorted(labels):
        label = [] if labels[name] == ["none"] else labels[name]
        sets.append(compared(given.folder / name, label))
        print(json.dumps(sets[-1]), flush=True)
    Console(width=150).print(table(sets))
    if given.output:
        given.output.write_text(json.dumps(sets, indent=1) + "\n")


if __name__ == "__main__":
    main()
