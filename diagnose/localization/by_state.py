"""Partitions of the gap by state: angular velocity, slip, sinkage, travel and wheel angle."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from diagnose.localization.kinematics import RunKinematics
from diagnose.localization.settings import DEFAULT_LOCALIZATION, LocalizationSettings
from diagnose.localization.shares import Partition, RunMisfit, partition_by_bin
from diagnose.localization.spectrum import STANDING_LABEL

NOT_RECORDED_LABEL = "not recorded"

EDGE_ROUNDING = 1e-6
"""Share of an axis' range by which a value may lie under an edge and still count as on it."""

DEG_PER_RAD = float(np.rad2deg(1.0))


def by_state(
    runs: Sequence[RunMisfit], settings: LocalizationSettings = DEFAULT_LOCALIZATION
) -> list[Partition]:
    """Partition by every state variable that is known of some run."""
    axes = [
        ("angular velocity", "deg/s", DEG_PER_RAD, lambda m: m.omega, None, NOT_RECORDED_LABEL),
        ("slip", "", 1.0, lambda m: m.slip, np.array(settings.slip_edges), STANDING_LABEL),
        ("sinkage", "mm", 1e3, lambda m: m.sinkage, None, NOT_RECORDED_LABEL),
        ("travel", "m", 1.0, lambda m: m.travel, None, NOT_RECORDED_LABEL),
        (
            "wheel angle",
            "deg",
            DEG_PER_RAD,
            lambda m: np.mod(m.angle, 2 * np.pi),
            np.arange(45.0, 360.0, 45.0),
            NOT_RECORDED_LABEL,
        ),
    ]
    partitions = []
    for axis, unit, scale, variable, edges, otherwise in axes:
        values = _values(runs, variable, scale)
        if values is None:
            continue
        edges = _edges(np.concatenate(values), settings) if edges is None else edges
        labels = [*_labels(edges, unit), otherwise]
        slack = EDGE_ROUNDING * float(np.abs(edges).max(initial=0))
        places = [
            np.where(np.isfinite(v), np.searchsorted(edges - slack, v), len(edges) + 1)
            for v in values
        ]
        partitions.append(partition_by_bin(runs, axis, labels, places))
    return partitions


def _values(
    runs: Sequence[RunMisfit],
    variable: Callable[[RunKinematics], np.ndarray | None],
    scale: float,
) -> list[np.ndarray] | None:
    """A variable of every run times `scale`, NaN where it is not known; None where it never is."""
    values = [variable(run.motion) for run in runs]
    if all(v is None for v in values):
        return None
    nothing = [np.full(len(run.motion.time), np.nan) for run in runs]
    return [n if v is None else scale * v for v, n in zip(values, nothing, strict=True)]


def _edges(values: np.ndarray, settings: LocalizationSettings) -> np.ndarray:
    """Inner edges of bins at round numbers, with about as much time in each."""
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [1, 99]) if len(values) else (0.0, 0.0)
    if not high - low > 1e-6 * max(abs(low), abs(high), 1e-9):
        return np.zeros(0)
    wide = (high - low) / settings.edge_steps
    power = 10.0 ** np.floor(np.log10(wide))
    step = power * next(each for each in (1, 2, 5, 10) if each * power >= wide)
    # The time at which a wheel stands says little of where the edges should be.
    moving = values[np.abs(values) > 0.01 * max(abs(low), abs(high))]
    parts = np.percentile(moving, np.linspace(0, 100, settings.state_bins + 1)[1:-1])
    edges = np.unique(np.round(step * np.round(parts / step), 9))
    return edges[(edges > low) & (edges < high)]


def _labels(edges: np.ndarray, unit: str) -> list[str]:
    unit = f" {unit}" if unit else ""
    if not len(edges):
        return [f"all alike{unit and ' in' + unit}"]
    inner = [f"{a:g} to {b:g}{unit}" for a, b in itertools.pairwise(edges)]
    return [f"under {edges[0]:g}{unit}", *inner, f"over {edges[-1]:g}{unit}"]
