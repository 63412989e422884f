r"""True budget of a gap: the share that each of several mechanisms has in it.

$v(S)$ is the RMS residual of the reference model at matched mean sinkage against noise-free runs of
the plant with the mechanisms $S$ alone, by channel. What a mechanism adds depends on which of the
others are there already, so its part is the mean over all orders in which they may be added, the
Shapley value (L. S. Shapley 1953, A value for n-person games):

$$\varphi_i = \sum_{S \not\ni i} \frac{|S|!\,(k - |S| - 1)!}{k!}\,(v(S \cup i) - v(S)) .$$

The parts add up to $v(\text{all}) - v(\emptyset)$, and divided by that the shares to one.
$v(\emptyset)$ is what finer plates and steps leave, far below the noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import factorial

import numpy as np

from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import DEFAULT_PLANT, FIT_PLATE_SIZE, Part, PlantSettings
from diagnose.blind.plant.rig import DEFAULT_RIG, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from drftjax.recorded.matched_zeta import ZetaMatchSettings, match_mean_sinkage

CHANNELS = ("x", "z")

Subset = frozenset[str]

# Mean sinkages are met to a few micrometres, a tenth of the noise.
MATCH = ZetaMatchSettings(min_step=2e-4)


def shapley_values(value: Mapping[Subset, float]) -> dict[str, float]:
    """Shapley value of each player of a game.

    Args:
        value: Value of every subset of the players, the empty one included.

    Returns:
        Part of each player, by name; all add up to the value of all less that of none.
    """
    everyone = max(value, key=len)
    count = len(everyone)
    parts = dict.fromkeys(sorted(everyone), 0.0)
    for player in parts:
        for subset in (each for each in value if player not in each):
            size = len(subset)
            weight = factorial(size) * factorial(count - size - 1) / factorial(count)
            parts[player] += weight * (value[subset | {player}] - value[subset])
    return parts


def subsets(names: Sequence[str]) -> list[Subset]:
    """All subsets of some names, the empty one first."""
    return [frozenset(each) for size in range(len(names) + 1) for each in combinations(names, size)]


def true_budget(
    parts: Mapping[str, Part],
    runs: Sequence[tuple[PlannedRun, float]],
    settings: PlantSettings = DEFAULT_PLANT,
    rig: PlantRig = DEFAULT_RIG,
) -> dict:
    """Budget of the gap of some runs of the plant, as a label holds it.

    Args:
        parts: Mechanisms of the plant, by name.
        runs: Runs, each with its zeta [-].
        settings: Resolution of the plant.
        rig: Wheel, masses, carriage and sand.

    Returns:
        By channel: the RMS gap with every mechanism and with none [mm]; and for each mechanism its
        share [-], its Shapley value, the gap with it alone and that with all others alone [mm].

    Raises:
        InputError: The plant, or the reference model, cannot make a run.
    """
    groups = plant.groups_of(tuple(parts.values()), plant.COMMON_GROUPS)
    gaps: dict[Subset, dict[str, float]] = {}
    for subset in subsets(list(parts)):
        present = [part for name, part in parts.items() if name in subset]
        misses = [_residual(present, run, zeta, groups, settings, rig) for run, zeta in runs]
        joined = np.concatenate(misses, axis=1)
        rms = 1e3 * np.sqrt(np.mean(joined**2, axis=1))
        gaps[subset] = dict(zip(CHANNELS, rms.tolist(), strict=True))
    everyone, none = frozenset(parts), frozenset[str]()
    channels = {}
    for channel in CHANNELS:
        value = {subset: gap[channel] for subset, gap in gaps.items()}
        excess = value[everyone] - value[none]
        channels[channel] = {
            "before": value[everyone],
            "none": value[none],
            "effects": {
                name: {
                    "share": part / excess,
                    "shapley": part,
                    "alone": value[frozenset([name])],
                    "without": value[everyone - {name}],
                }
                for name, part in shapley_values(value).items()
            },
        }
    return {"unit": "mm", "channels": channels}


def _residual(
    parts: Sequence[Part],
    run: PlannedRun,
    zeta: float,
    groups: Sequence[str],
    settings: PlantSettings,
    rig: PlantRig,
) -> np.ndarray:
    """Reference model at matched mean sinkage less the plant [m], shape (channels, rows)."""
    real = plant.run_plant(parts, run, zeta, groups, settings, rig)
    # As a fit has it: its plates and steps, and the sinkage that was read before the run.
    plates = FIT_PLATE_SIZE / rig.length_scale
    coarse = replace(settings, plate_size=plates, step_refinement=1.0)
    model: PlantReading = real

    def miss(log_zeta: np.ndarray) -> float:
        nonlocal model
        tried = zeta * float(np.exp(log_zeta))
        model = plant.run_plant((), run, tried, (), coarse, rig, sinkage=-float(real.z[0]))
        return float((model.z - real.z).mean())

    # Rise per unit of log zeta, about that of any wheel as deep in the sand [m].
    rise = 0.15 * rig.radius
    match_mean_sinkage(miss, 0.0, slope=rise, settings=MATCH)
    return np.stack([getattr(model, each) - getattr(real, each) for each in CHANNELS])
