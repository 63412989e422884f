"""Recorded and simulated curves of runs, as the figure of a report page draws them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drftjax.common.text import replace_unprintable


@dataclass(frozen=True)
class CurveSettings:
    """Numbers that bound the size of a page.

    Attributes:
        max_values: Numbers of all curves at most: under 1 MB of text.
        max_points: Samples of a run at most; more than a wide screen has columns helps zooming
            alone.
        min_points: Samples that a run's shape needs; runs that would have fewer are left out.
        resolution: Numbers are rounded to this share of the noise floor [-], and of the
            curve's range where none is known.
        range_resolution: The latter [-].
    """

    max_values: int = 120_000
    max_points: int = 4000
    min_points: int = 100
    resolution: float = 0.05
    range_resolution: float = 1e-4


DEFAULT_CURVES = CurveSettings()


@dataclass(frozen=True)
class CurveLabels:
    """Labels of the curves.

    Attributes:
        recorded: Of what was measured.
        before: Of the model as it was believed.
        after: Of the model with what was found.
        floor: Of the band about zero.
    """

    recorded: str = "recorded"
    before: str = "before"
    after: str = "after"
    floor: str = "noise floor"


@dataclass(frozen=True, eq=False)
class CurvePanel:
    """One quantity of one run, recorded and simulated.

    Attributes:
        quantity, unit: Its name, and the unit of all numbers.
        recorded: Shape (samples,); NaN leaves a gap. None for what is not measured.
        before, after: Simulated less recorded, likewise; None for a model that there is not. The
            simulated values themselves where nothing is recorded.
        floor: Noise floor; None where none is known.
        downward: True for a quantity whose axis points down, such as a sinkage.
    """

    quantity: str
    unit: str
    recorded: np.ndarray | None
    before: np.ndarray | None
    after: np.ndarray | None
    floor: float | None = None
    downward: bool = False


@dataclass(frozen=True, eq=False)
class RunPanels:
    """Panels of one run.

    Attributes:
        name: Of the run.
        time: Of the samples [s], shape (samples,).
        panels: One for each quantity.
    """

    name: str
    time: np.ndarray
    panels: Sequence[CurvePanel]


@dataclass(frozen=True, eq=False)
class RunCurves:
    """All runs of a page.

    Attributes:
        runs: One at least.
        labels: Of the curves.
    """

    runs: Sequence[RunPanels]
    labels: CurveLabels


def channel_panel(
    channel: str,
    unit: str,
    scale: float,
    recorded: np.ndarray,
    before: np.ndarray | None,
    after: np.ndarray | None,
    floor: float | None = None,
) -> CurvePanel:
    """Panel of a channel; height z is shown as the sinkage -z, downward.

    Args:
        channel: Name among x, z, fx, fz, torque.
        unit, scale: Unit that it is shown in, and the factor to it.
        recorded: Recorded values [m, N, N m], shape (samples,).
        before, after: Simulated less recorded [m, N, N m], shape (samples,), or None.
        floor: Noise floor [m, N, N m], or None.
    """
    sinks = channel == "z"
    factor = -scale if sinks else scale
    return CurvePanel(
        quantity=QUANTITIES.get(channel, channel),
        unit=unit,
        recorded=factor * recorded,
        before=None if before is None else factor * before,
        after=None if after is None else factor * after,
        floor=None if floor is None else scale * floor,
        downward=sinks,
    )


QUANTITIES = {
    "x": "travel",
    "z": "sinkage",
    "fx": "force fx",
    "fz": "force fz",
    "torque": "torque",
}


def curve_document(curves: RunCurves, settings: CurveSettings = DEFAULT_CURVES) -> dict:
    """Curves as plain values for a page's script, thinned so that the page stays small.

    Args:
        curves: Of all runs.
        settings: Numbers that bound the size.

    Returns:
        `labels` by curve, `left_out` runs [count], and `runs`: each with its `name`, `every` n-th
        sample drawn, `time` [s] and `panels`.
    """
    lines = max(1 + sum(_lines(panel) for panel in run.panels) for run in curves.runs)
    most_runs = max(1, settings.max_values // (lines * settings.min_points))
    shown = curves.runs[:most_runs]
    points = min(settings.max_points, settings.max_values // (lines * len(shown)))
    return {
        "labels": vars(curves.labels),
        "left_out": len(curves.runs) - len(shown),
        "runs": [_run(each, points, settings) for each in shown],
    }


def _lines(panel: CurvePanel) -> int:
    return sum(each is not None for each in (panel.recorded, panel.before, panel.after))


def _run(run: RunPanels, points: int, settings: CurveSettings) -> dict:
    every = max(1, math.ceil(len(run.time) / points))
    return {
        "name": replace_unprintable(run.name),
        "every": every,
        "time": _rounded(run.time[::every], 4),
        "panels": [_panel(each, every, settings) for each in run.panels],
    }


def _panel(panel: CurvePanel, every: int, settings: CurveSettings) -> dict:
    places = _places(panel, settings)

    def thinned(values: np.ndarray | None) -> list[float | None] | None:
        return None if values is None else _rounded(values[::every], places)

    return {
        "quantity": panel.quantity,
        "unit": panel.unit,
        "downward": panel.downward,
        "places": places,
        "floor": panel.floor if panel.floor and math.isfinite(panel.floor) else None,
        "recorded": thinned(panel.recorded),
        "before": thinned(panel.before),
        "after": thinned(panel.after),
    }


def _places(panel: CurvePanel, settings: CurveSettings) -> int:
    """Decimal places that the finest difference worth seeing needs."""
    values = next(v for v in (panel.recorded, panel.after, panel.before, [0.0]) if v is not None)
    finite = np.asarray(values)[np.isfinite(values)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    finest = settings.range_resolution * span
    if panel.floor and math.isfinite(panel.floor):
        finest = settings.resolution * panel.floor
    return min(max(math.ceil(-math.log10(finest)), 0), 9) if finest > 0 else 3


def _rounded(values: np.ndarray, places: int) -> list[float | None]:
    """Values to so many decimal places; what is not finite becomes None, which JSON has."""
    return [
        round(each, places) + 0.0 if math.isfinite(each) else None  # no minus before zero
        for each in np.asarray(values, float).tolist()
    ]
