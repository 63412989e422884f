"""Figure of a comparison: the difference between now and before, and what explains it."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnose.change.budget import mean_of
from diagnose.change.differences.gram import SharedClock
from diagnose.change.result import ChangeDiagnosis
from drftjax.common.figures import (
    AFTER,
    CHANNEL_AXES,
    FAINT,
    RECORDED,
    label_difference,
    legend_below,
    panel_rows,
    project_style,
)


@dataclass(frozen=True)
class DifferenceFigureSettings:
    """Sizes of the figure.

    Attributes:
        max_conditions: Conditions that are drawn at most.
        max_points: Points of a line, about at most.
        height: Of a panel [inches].
    """

    max_conditions: int = 8
    max_points: int = 600
    height: float = 2.2


DEFAULT_DIFFERENCE_FIGURE = DifferenceFigureSettings()


@project_style
def difference_figure(
    found: ChangeDiagnosis, settings: DifferenceFigureSettings = DEFAULT_DIFFERENCE_FIGURE
) -> Figure:
    """Recorded difference of each channel, condition by condition, with the explained one."""
    differences = found.problem.differences
    clocks = differences.clocks[: settings.max_conditions]
    places = [(clock, at) for clock in clocks for at in range(len(differences.dataset.channels))]
    figure, panels = panel_rows(len(places), settings.height)
    for (clock, place), axes in zip(places, panels, strict=True):
        _draw(axes, found, clock, place, settings)
        axes.set_xlabel("time [s]")
    legend_below(figure, panels)
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
    scale = label_difference(axes, channel, "now - before")
    before, after = (
        mean_of(differences, clock, condition.now, residual)[place]
        - mean_of(differences, clock, condition.before, residual)[place]
        for residual in (problem.residual_without(None), problem.residual_by_law(found.chosen))
    )
    step = max(1, len(clock.time) // settings.max_points)
    shown = slice(None, None, step)
    # A residual is simulated less recorded.
    lines = (("recorded", -before, RECORDED), ("explained", after - before, AFTER))
    for label, values, role in lines:
        if np.isfinite(values).all():
            axes.plot(clock.time[shown], scale * values[shown], **role.line, label=label)
    axes.axhline(0, color=FAINT, lw=0.5)
    name = differences.dataset.runs[condition.now[0]].name
    axes.set_title(f"{CHANNEL_AXES[channel].label}, as {name}", parse_math=False)
