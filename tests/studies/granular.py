"""Runs of a granular physics engine, diagnosed: is what plates found there what the wheel shows?

Flat plates pushed into the bed BM1 found a stress of 18 kPa and 0.50 N/cm3 of depth, where the
reference model knows the second term alone. The wheel's runs in the same bed are diagnosed by the
whole catalogue, then by the stress laws alone, then with the plates' own law put into the model.

    python -m tests.studies.granular [--data FOLDER]
"""

import argparse
import copy
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from diagnose.api import effects_among, possible_effects
from diagnose.dataset import RigDataset
from diagnose.gap.cross_validation import at_mean_sinkage, predict_held_out
from diagnose.gap.zeta_matching import residuals_of
from diagnose.hypotheses.hypothesis import Hypothesis
from diagnose.pipeline import diagnose
from diagnose.result import Diagnosis
from diagnose.run_pool import RunPool
from drftjax.common.jax_config import configure_jax
from drftjax.effects.base import AbstractEffect
from drftjax.effects.catalogue import effect_class
from drftjax.effects.stress import REFERENCE_DEPTH
from drftjax.recorded.prepared_run import PreparedRun, prepare_run
from drftjax.runlog.hdf5.api import read_run
from drftjax.setups.from_run import setup_from_run

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT.parent / "shared" / "granular"
# One packing of the bed; the same with a second packing, which repeats one of its commands.
ONE_PACKING = ("BM1_60", "BM1_120", "BM1_240", "BM1_400", "BM1_paper")
TWO_PACKINGS = (*ONE_PACKING, "BM2_120", "BM2_paper07")
STRESS_LAWS = ("depth_hardening", "cohesion")
# Chosen by hand once the catalogue's answer was seen: what explains z, what explains x, the law.
BY_HAND = ("surface_slope", "wheel_radius", "travel_gain", "cohesion")
# Stress of flat plates in BM1: at the surface [Pa], and its rise with depth [Pa/m].
PLATE_OFFSET, PLATE_RISE = 18e3, 0.50e6
# Depths that the wheel's plates reach there [m].
DEPTHS = np.linspace(0.0, 0.03, 61)
MM = 1e3
# Further off than this no run is followed any more [mm].
FAR = 1e3


def plates_as_hardening() -> float:
    """The depth_hardening that comes closest to the plates' stress over the wheel's depths.

    c d (1 + excess (d / 20 mm - 1)) is linear in c (1 - excess) and c excess / 20 mm.
    """
    columns = np.stack([DEPTHS, DEPTHS**2], axis=1)
    stress = PLATE_OFFSET + PLATE_RISE * DEPTHS
    linear, square = np.linalg.lstsq(columns, stress, rcond=None)[0]
    square *= REFERENCE_DEPTH
    return float(square / (linear + square))


def runs(folder: Path, names: Sequence[str], effects: Sequence[dict] = ()) -> list[PreparedRun]:
    """Runs made ready, believed to have these effects already."""
    found = []
    for name in names:
        run = read_run(folder / f"{name}.h5")
        believed = copy.deepcopy(setup_from_run(run))
        believed.effects = [dict(each) for each in effects]
        found.append(prepare_run(name, run, model=believed))
    return found


def rms(dataset: RigDataset, residual: Sequence[np.ndarray], channel: str) -> float:
    """Of all runs together [mm]."""
    values = [each[dataset.channels.index(channel)] for each in residual]
    return MM * float(np.sqrt(np.mean(np.concatenate(values) ** 2)))


def shown(error: float) -> str:
    """An error [mm]; numbers that straight lines put out of bounds may make a run fly off."""
    return f"{error:.2f}" if error < FAR else "flies off"


def numbers_of(each: Hypothesis) -> str:
    """An explanation's numbers, in SI units."""
    values = zip(each.model.free, each.coordinates, strict=True)
    return ", ".join(f"{free.field} {float(free.value(at)):.3g}" for free, at in values)


def explanations(found: Diagnosis) -> Table:
    """Every explanation that was simulated, as ranked, with its error on runs left out."""
    dataset, regressors = found.dataset, found.screening.regressors
    table = Table(title="RMSE mm", title_justify="left")
    for column in (
        "explanation",
        "x fitted",
        "x left out",
        "z fitted",
        "z left out",
        "zeta / 0.97",
    ):
        table.add_column(column, justify="left" if column == "explanation" else "right")
    table.add_column("numbers")
    for each in (found.screening.none, *found.screening.singles, *found.screening.pairs):
        with RunPool() as pool:
            unseen = predict_held_out(regressors, each, pool).residual
        table.add_row(
            " + ".join(each.names) or "none",
            *(shown(rms(dataset, part, c)) for c in "xz" for part in (each.residual, unseen)),
            f"{np.exp(each.log_zeta).mean():.2f}",
            numbers_of(each),
        )
    return table


def say(console: Console, title: str, found: Diagnosis) -> None:
    """Print a diagnosis."""
    weights = ", ".join(f"{name} {w:.2f}" for name, w in list(found.weights.items())[:4])
    console.print(f"\n{title}", style="bold")
    console.print(f"verdict {', '.join(found.verdict)}; weights {weights}")
    regressors = found.screening.regressors
    with RunPool() as pool:
        held_out = predict_held_out(regressors, found.chosen, pool)
        left = residuals_of(at_mean_sinkage(held_out, pool))
    leading = " + ".join(found.chosen.names) or "the reference model"
    added = " + ".join(each.about.name for each in found.selected.effects) or "nothing"
    for channel, gap in found.gap.items():
        console.print(
            f"{channel}: {gap.before * MM:.2f} mm, floor {gap.floor * MM:.2f} mm; on runs left out "
            f"{shown(rms(found.dataset, left, channel))} mm by {leading}, which leads, and "
            f"{shown(gap.after * MM)} mm by {added}, which the model file holds"
        )
    for note in found.notes:
        console.print(f"note: {note}")
    console.print(explanations(found))


def diagnosed(
    candidates: Sequence[PreparedRun], effects: Sequence[type[AbstractEffect]]
) -> Diagnosis:
    """What the diagnosis says of some runs."""
    return diagnose(RigDataset.of(candidates), possible_effects(candidates, effects))


def answers(folder: Path, console: Console) -> None:
    """Print all diagnoses."""
    everything = effects_among(None)
    laws = tuple(effect_class(name) for name in STRESS_LAWS)
    one = runs(folder, ONE_PACKING)
    say(console, "One packing, by the whole catalogue", diagnosed(one, everything))
    two = runs(folder, TWO_PACKINGS)
    say(console, "Two packings, by the whole catalogue", diagnosed(two, everything))
    say(console, "One packing, by the stress laws alone", diagnosed(one, laws))
    say(console, "Two packings, by the stress laws alone", diagnosed(two, laws))
    depth = PLATE_OFFSET / PLATE_RISE
    hand = tuple(effect_class(name) for name in BY_HAND)
    say(console, "Two packings, by four effects chosen by hand", diagnosed(two, hand))
    by_plates = runs(folder, ONE_PACKING, [{"name": "cohesion", "depth": depth}])
    title = f"One packing, with the plates' own law in the model (cohesion {depth * MM:.0f} mm)"
    say(console, title, diagnosed(by_plates, laws[:1]))
    console.print(
        f"\nThe plates' law as a depth_hardening over the wheel's depths, 0 to 30 mm: excess "
        f"{plates_as_hardening():.2f}."
    )


def main() -> None:
    """Print what the diagnosis says of the runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=FOLDER)
    folder: Path = parser.parse_args().data
    if not folder.is_dir():
        sys.exit(f"{folder}: there is no such folder; the runs are not part of this project")
    configure_jax()
    answers(folder, Console(width=150))


if __name__ == "__main__":
    main()
