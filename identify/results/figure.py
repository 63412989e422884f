"""Figure of a fit: recorded and simulated channels."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from drftjax.recorded.observation import SHOWN
from drftjax.results.comparison_figure import ComparedChannel, comparison_figure
from identify.results.values import RunFit, Value

# Runs that are drawn, at most.
MOST_RUNS = 12


def plot_fit(
    fitted: Sequence[RunFit],
    channels: Sequence[str],
    shared: Sequence[Value],
    bands: Mapping[str, Mapping[str, tuple[np.ndarray, np.ndarray]]],
    floors: Mapping[str, float],
) -> Figure:
    """Plot the channels of each run (the first twelve), each above its residual.

    Args:
        fitted: Runs of the fit.
        channels: Channels that any of them compares.
        shared: Shared values, for the title.
        bands: Lower and upper end of expected readings, by run and channel [m, N, N m].
        floors: Noise floors by channel [m, N, N m], where they are known.
    """
    runs = fitted[:MOST_RUNS]
    compared = [
        each for run in runs for each in _compared(run, channels, bands.get(run.name, {}), floors)
    ]
    count = "one run" if len(fitted) == 1 else f"{len(fitted)} runs"
    more = f" ({len(runs)} shown)" if len(runs) < len(fitted) else ""
    return comparison_figure(compared, f"fit of {count}{more}  {', '.join(map(str, shared))}")


def _compared(
    run: RunFit,
    channels: Sequence[str],
    bands: Mapping[str, tuple[np.ndarray, np.ndarray]],
    floors: Mapping[str, float],
) -> Iterator[ComparedChannel]:
    rmse = run.rmse()
    for channel in channels:
        if channel in run.channels:
            index, (unit, scale) = run.channels.index(channel), SHOWN[channel]
            yield ComparedChannel(
                f"{run.name}  RMSE {scale * rmse[channel]:.3f} {unit}",
                channel,
                run.time,
                run.recorded[index],
                {"before": run.before[index], "fitted": run.after[index]},
                floors.get(channel),
                bands.get(channel),
            )
