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

import numpy as np

from diagnose.blind.plant import plant
from diagnose.blind.plant.plant import DEFAULT_PLANT, FIT_PLATE_SIZE, Part, PlantSettings
from diagnose.blind.plant.rig import DEFAULT_RIG, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from diagnose.gap.budget import DEFAULT_BUDGET, shapley_values
from drftjax.recorded.matched_zeta import match_mean_sinkage

CHANNELS = ("x", "z")


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
    names, present = list(parts), list(parts.values())
    groups = plant.groups_of(tuple(present), plant.COMMON_GROUPS)
    count, everyone = len(names), (1 << len(names)) - 1

    def gap(mask: int) -> np.ndarray:
        some = [part for place, part in enumerate(present) if mask >> place & 1]
        misses = [_residual(some, run, zeta, groups, settings, rig) for run, zeta in runs]
        return 1e3 * np.sqrt(np.mean(np.concatenate(misses, axis=1) ** 2, axis=1))

    gaps = np.array([gap(mask) for mask in range(1 << count)])
    channels = {}
    for channel, values in zip(CHANNELS, gaps.T.tolist(), strict=True):
        sizes = shapley_values(values.__getitem__, count).tolist()
        excess = values[everyone] - values[0]
        channels[channel] = {
            "before": values[everyone],
            "none": values[0],
            "effects": {
                name: {
                    "share": size / excess,
                    "shapley": size,
                    "alone": values[1 << place],
                    "without": values[everyone & ~(1 << place)],
                }
                for place, (name, size) in enumerate(zip(names, sizes, strict=True))
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
    match_mean_sinkage(miss, 0.0, slope=rise, settings=DEFAULT_BUDGET.match)
    return np.stack([getattr(model, each) - getattr(real, each) for each in CHANNELS])
