"""The gap cut by state: angular velocity, slip, sinkage, travel and the wheel's angle."""

import itertools
from collections.abc import Sequence

import numpy as np

from diagnose.localization.shares import Partition, RunMisfit, partition_by_bin
from diagnose.localization.spectrum import STANDS

# About as many bins in a state variable.
STATE_BINS = 5


# Their edges lie on a grid of about as many steps.
EDGE_STEPS = 25


# Share of an axis' range by which a value may lie under an edge and still count as on it.
ROUNDING = 1e-6


SLIP_EDGES = (0.0, 0.1, 0.2, 0.3, 0.5)


UNSEEN = "not recorded"


def by_state(runs: Sequence[RunMisfit]) -> list[Partition]:
    """An axis for every variable of the state that some run tells."""

    def all_of(pick, scale: float = 1.0) -> list[np.ndarray] | None:
        values = [pick(run.motion) for run in runs]
        if all(v is None for v in values):
            return None
        nothing = [np.full(len(run.motion.time), np.nan) for run in runs]
        return [n if v is None else scale * v for v, n in zip(values, nothing, strict=True)]

    degrees = float(np.rad2deg(1.0))
    axes = [
        ("angular velocity", "deg/s", all_of(lambda m: m.omega, degrees), None, UNSEEN),
        ("slip", "", all_of(lambda m: m.slip), np.array(SLIP_EDGES), STANDS),
        ("sinkage", "mm", all_of(lambda m: m.sinkage, 1e3), None, UNSEEN),
        ("travel", "m", all_of(lambda m: m.travel), None, UNSEEN),
        (
            "wheel angle",
            "deg",
            all_of(lambda m: np.mod(m.angle, 2 * np.pi), degrees),
            np.arange(45.0, 360.0, 45.0),
            UNSEEN,
        ),
    ]
    cuts = []
    for axis, unit, values, edges, otherwise in axes:
        if values is None:
            continue
        edges = _edges(np.concatenate(values)) if edges is None else edges
        labels = [*_labels(edges, unit), otherwise]
        slack = ROUNDING * float(np.abs(edges).max(initial=0))
        places = [
            np.where(np.isfinite(v), np.searchsorted(edges - slack, v), len(edges) + 1)
            for v in values
        ]
        cuts.append(partition_by_bin(runs, axis, labels, places))
    return cuts


def _edges(values: np.ndarray) -> np.ndarray:
    """Inner edges of bins at round numbers, with about as much time in each."""
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [1, 99]) if len(values) else (0.0, 0.0)
    if not high - low > 1e-6 * max(abs(low), abs(high), 1e-9):
        return np.zeros(0)
    wide = (high - low) / EDGE_STEPS
    power = 10.0 ** np.floor(np.log10(wide))
    step = power * next(each for each in (1, 2, 5, 10) if each * power >= wide)
    # A wheel that stands says little of where the edges should be.
    moving = values[np.abs(values) > 0.01 * max(abs(low), abs(high))]
    parts = np.percentile(moving, np.linspace(0, 100, STATE_BINS + 1)[1:-1])
    edges = np.unique(np.round(step * np.round(parts / step), 9))
    return edges[(edges > low) & (edges < high)]


def _labels(edges: np.ndarray, unit: str) -> list[str]:
    unit = f" {unit}" if unit else ""
    if not len(edges):
        return [f"all alike{unit and ' in' + unit}"]
    inner = [f"{a:g} to {b:g}{unit}" for a, b in itertools.pairwise(edges)]
    return [f"under {edges[0]:g}{unit}", *inner, f"over {edges[-1]:g}{unit}"]
