"""Figure of a cross-check: both zetas of each run, and the error that the tuner saw."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.figures import (
    AFTER,
    RECORDED,
    SIMULATED,
    TRUE,
    draw_floor,
    label_difference,
    legend_below,
    panel_rows,
    project_style,
    title_above,
)
from identify.crosscheck.crosscheck import CrossCheck, RunCheck
from identify.zeta_path.path import SEGMENTS, segment_ends

MOST_SHOWN = 8


@project_style
def plot_crosscheck(result: CrossCheck) -> Figure:
    """Figure of each run (the first eight): both zetas, and the error that the tuner saw."""
    runs = result.runs[:MOST_SHOWN]
    figure, panels = panel_rows(2 * len(runs), 2.7)
    for run, left, right in zip(runs, panels[::2], panels[1::2], strict=True):
        _draw_zeta(left, run)
        scale = label_difference(right, "z", "residual")
        draw_floor(right, scale * result.setting.tolerance, "tolerance of the tuner")
        # Recorded less simulated sinkage is simulated less recorded z.
        right.plot(run.time, scale * run.error, **SIMULATED.line)
        right.set_title("simulated less recorded")
        left.set_xlabel("time [s]")
        right.set_xlabel("time [s]")
    legend_below(figure, panels, columns=3)
    left_out = len(result.runs) - len(runs)
    more = f" (and {left_out} more runs)" if left_out else ""
    setting = result.setting
    title_above(
        figure,
        f"tuner: tick {1e3 * setting.tick:g} ms, zeta step {setting.zeta_step:g}, "
        f"tolerance {1e3 * setting.tolerance:g} mm{more}",
    )
    return figure


def _draw_zeta(axes: Axes, run: RunCheck) -> None:
    path = run.offline
    if run.online_time is not None and run.online_zeta is not None:
        axes.plot(run.online_time, run.online_zeta, **RECORDED.line, label="tuner, as logged")
    if run.truth is not None:
        axes.plot(run.time, run.truth, **TRUE.line, label="true")
    axes.plot(run.time, run.zeta, **SIMULATED.line, label="tuner, replayed")
    low, high = axes.get_ylim()
    curve = segment_ends(path.time)
    told = np.interp(curve, path.time, path.identified.astype(float)) == 1.0
    shown = np.where(told, path.at(curve), np.nan)
    axes.plot(curve, shown, **AFTER.line, marker=".", markevery=SEGMENTS, label="offline")
    # Where nothing is told the band is wider than any axes.
    error = np.minimum(1.645 * path.error, 10.0)
    band = (path.value - error, path.value + error)
    axes.fill_between(path.time, *band, color=AFTER.colour, alpha=0.2, lw=0, label="90 % band")
    inside = np.r_[low, high, path.value[path.identified]]
    axes.set_ylim(inside.min() - 0.01, inside.max() + 0.01)
    axes.set_ylabel("zeta [-]")
    late = "-" if run.tuner.lag is None else f"{run.tuner.lag:.2f} s"
    title = f"{run.name}\ndifference {run.tuner.difference:.4f}, lag {late}"
    axes.set_title(title, parse_math=False)
