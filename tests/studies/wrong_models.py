"""Fits of runs with an effect that the model lacks: bias of zeta beside the error it is given.

    python -m tests.studies.wrong_models [--by-noise] [-o FILE.json]

Each of twelve effects, at half, once and twice its typical strength, is in the true rig and not in
the model. Four runs of the example rig are fitted, each by a zeta of its own, and one lambda.
"""

import argparse
import json
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.jax_config import configure_jax
from drftjax.effects.catalogue import effect_class, field_metadata, strengths
from drftjax.runlog.record import RunLog
from identify.api import fit
from identify.fit_constant import FIT_SETTINGS, FitSettings
from tests.studies.example_runs import NOISE, PROFILES, ZETA, make

EFFECTS = (
    "drawbar",
    "horizontal_coulomb",
    "horizontal_viscous",
    "cable_spring",
    "bulldozing",
    "surface_slope",
    "excavation",
    "speed_gain",
    "wheel_radius",
    "grouser_height",
    "travel_gain",
    "measurement_delay",
)
STRENGTHS = (0.5, 1.0, 2.0)
# Small: within so much, or within so many of the errors told.
SMALL_BIAS, SMALL_ERRORS = 0.03, 2.0
SEED = 7


@dataclass(frozen=True)
class Case:
    """One fit of four runs.

    Attributes:
        effect, strength: In the rig and not in the model; as a share of the typical strength.
        bias, error: Of zeta, RMS over the runs, as a share of the truth [-].
        small: Share of the runs whose bias is small.
        value: Of lambda, whose truth is 1.1.
        status: Of the fit.
        floors: Residual of z and x over the instruments' noise, before the fit and after it [-].
    """

    effect: str
    strength: float
    bias: float
    error: float
    small: float
    value: float
    status: str
    floors: dict[str, tuple[float, float]]


def run_with(effect: str, strength: float, name: str, random: np.random.Generator) -> RunLog:
    """A run of the example rig with an effect at a share of its typical strength [-]."""
    kind = effect_class(effect)
    typical = field_metadata(kind)
    entry = {each: strength * typical[each]["typical"] for each in strengths(kind)}
    return make(name, random, [{"name": effect} | entry], scatter=0.0, step=None)


def case(effect: str, strength: float, settings: FitSettings = FIT_SETTINGS) -> Case:
    """Fit four runs of a rig with an effect at a share of its typical strength [-]."""
    random = np.random.default_rng(SEED)
    runs = {name: run_with(effect, strength, name, random) for name in PROFILES}
    found = fit(runs, settings=settings)
    zetas = [run.values["terrain.zeta"] for run in found.runs]
    bias = np.array([each.value / ZETA - 1 for each in zetas])
    error = np.array([each.error / ZETA for each in zetas])
    small = (np.abs(bias) < SMALL_BIAS) | (np.abs(bias) < SMALL_ERRORS * error)
    (shared,) = found.shared.values()
    before, after = found.rmse(False), found.rmse()
    return Case(
        effect,
        strength,
        float(np.sqrt(np.mean(bias**2))),
        float(np.sqrt(np.mean(error**2))),
        float(small.mean()),
        shared.value,
        found.status,
        {channel: (before[channel] / NOISE, after[channel] / NOISE) for channel in ("z", "x")},
    )


def table(cases: list[Case]) -> Table:
    titles = ("effect", "strength", "zeta off [%]", "error told [%]", "small", "lambda", "status")
    table = Table(*titles, "z before, after [floors]", "x before, after [floors]")
    for each in cases:
        floors = (
            f"{each.floors[channel][0]:.0f}, {each.floors[channel][1]:.0f}" for channel in "zx"
        )
        table.add_row(
            each.effect,
            f"{each.strength:g}",
            f"{100 * each.bias:.1f}",
            f"{100 * each.error:.1f}",
            f"{each.small:.0%}",
            f"{each.value:.2f}",
            each.status,
            *floors,
        )
    table.caption = f"small in {np.mean([each.small for each in cases]):.0%} of all zetas"
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("-o", "--output", type=Path, help="write the figures here, as JSON")
    parser.add_argument(
        "--by-noise", action="store_true", help="first weights by the instruments' noise"
    )
    parser.add_argument("--effects", nargs="*", default=EFFECTS, choices=EFFECTS)
    given = parser.parse_args()
    configure_jax()
    settings = replace(FIT_SETTINGS, model_shares={}) if given.by_noise else FIT_SETTINGS
    cases = [case(*each, settings) for each in product(given.effects, STRENGTHS)]
    Console(width=140).print(table(cases))
    if given.output:
        given.output.write_text(json.dumps([asdict(each) for each in cases], indent=1) + "\n")


if __name__ == "__main__":
    main()
