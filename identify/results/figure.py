"""Figure of a fit: recorded and simulated channels."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.recorded.observation import SHOWN
from identify.results.values import RunFit, Value

# Runs that are drawn, at most.
MOST_RUNS = 12


def plot_fit(
    fitted: Sequence[RunFit],
    channels: Sequence[str],
    shared: Sequence[Value],
    bands: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
) -> Figure:
    """Plot one row for each run (the first twelve) and one column for each channel.

    Args:
        fitted: Runs of the fit.
        channels: Channels that any of them compares.
        shared: Shared values, for the title.
        bands: Lower and upper end of expected readings, by run and channel [m, N, N m].
    """
    runs = fitted[:MOST_RUNS]
    figure = Figure(figsize=(5.2 * len(channels), 2.1 * len(runs) + 0.6), layout="constrained")
    grid = figure.subplots(len(runs), len(channels), squeeze=False)
    for run, row in zip(runs, grid, strict=True):
        for channel, axes in zip(channels, row, strict=True):
            if channel in run.channels:
                band = bands.get(run.name, {}).get(channel)
                _draw(axes, run, run.channels.index(channel), band)
            else:
                axes.set_axis_off()
    first = next(axes for axes in grid.flat if axes.lines)
    first.legend(fontsize=7, loc="best")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    count = "one run" if len(fitted) == 1 else f"{len(fitted)} runs"
    more = f" ({len(runs)} shown)" if len(runs) < len(fitted) else ""
    figure.suptitle(f"fit of {count}{more}  {', '.join(map(str, shared))}", fontsize=10)
    return figure


def _draw(axes: Axes, run: RunFit, index: int, band: tuple | None) -> None:
    channel = run.channels[index]
    unit, scale = SHOWN[channel]
    if band is not None:
        low, high = (scale * edge for edge in band)
        axes.fill_between(
            run.time, low, high, color="C0", alpha=0.25, lw=0, label="90 % of readings"
        )
    marker = "." if len(run.time) < 5 else None
    axes.plot(
        run.time, scale * run.recorded[index], color="0.35", lw=2.2, marker=marker, label="recorded"
    )
    axes.plot(
        run.time,
        scale * run.before[index],
        color="C1",
        lw=0.9,
        ls="--",
        marker=marker,
        label="before",
    )
    axes.plot(run.time, scale * run.after[index], color="C0", lw=1.1, marker=marker, label="fitted")
    rmse = scale * run.rmse()[channel]
    axes.set_ylabel(f"{channel} [{unit}]")
    axes.set_title(f"{run.name}  RMSE {rmse:.3f} {unit}", fontsize=8, parse_math=False)
