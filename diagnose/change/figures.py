"""Figure of a comparison: the difference between now and before, and what explains it."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnose.change.budget import mean_of
from diagnose.change.differences.gram import SharedClock
from diagnose.change.result import ChangeDiagnosis
from drftjax.recorded.observation import SHOWN


@dataclass(frozen=True)
class DifferenceFigureSettings:
    """Sizes of the figure.

    Attributes:
        max_conditions: Conditions that are drawn at most.
        max_points: Points of a line, about at most.
        panel: Width and height of a panel [inches].
        recorded, explained: Colours of the two lines.
    """

    max_conditions: int = 8
    max_points: int = 600
    panel: tuple[float, float] = (4.4, 1.7)
    recorded: str = "#b8542f"
    explained: str = "#2a6f97"


DEFAULT_DIFFERENCE_FIGURE = DifferenceFigureSettings()


def difference_figure(
    found: ChangeDiagnosis, settings: DifferenceFigureSettings = DEFAULT_DIFFERENCE_FIGURE
) -> Figure:
    """Recorded difference of each channel, condition by condition, with the explained one."""
    problem = found.problem
    channels = problem.differences.dataset.channels
    clocks = problem.differences.clocks[: settings.max_conditions]
    width, height = settings.panel
    figure = Figure((width * len(channels), height * len(clocks)), layout="constrained")
    panels = figure.subplots(len(clocks), len(channels), squeeze=False)
    for row, clock in zip(panels, clocks, strict=True):
        for place, axes in enumerate(row):
            _draw(axes, found, clock, place, settings)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    panels[0, 0].legend(fontsize="x-small")
    return figure


def _draw(
    axes: Axes,
    found: ChangeDiagnosis,
    clock: SharedClock,
    place: int,
    settings: DifferenceFigureSettings,
) -> None:
    problem, condition = found.problem, clock.condition
    differences = problem.differences
    channel = differences.dataset.channels[place]
    unit, scale = SHOWN[channel]
    before, after = (
        mean_of(differences, clock, condition.now, residual)[place]
        - mean_of(differences, clock, condition.before, residual)[place]
        for residual in (problem.residual_at_common_zeta(), found.chosen.residual)
    )
    step = max(1, len(clock.time) // settings.max_points)
    shown = slice(None, None, step)
    # A residual is simulated less recorded.
    lines = (
        ("recorded", -before, settings.recorded),
        ("explained", after - before, settings.explained),
    )
    for label, values, colour in lines:
        if np.isfinite(values).all():
            axes.plot(clock.time[shown], scale * values[shown], color=colour, lw=1, label=label)
    axes.axhline(0, color="0.7", lw=0.5)
    name = differences.dataset.runs[condition.now[0]].name
    axes.set_title(f"{channel}, as {name}", fontsize="small")
    axes.set_ylabel(f"now less before [{unit}]", fontsize="small")
