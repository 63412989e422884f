"""Figures of sweeps and of slip curves, without a window."""

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from drftjax.common.figures import SIMULATED, STYLE, label_channel, project_style, title_above
from drftjax.sweeps.parameter_sweep import ParameterSweep
from drftjax.sweeps.steady_state import SteadyState


@project_style
def sweep_figure(sweep: ParameterSweep) -> Figure:
    """Sinkage and travel of every run over time, coloured by the first number swept."""
    figure = Figure(figsize=(STYLE.width, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    name, values = next(iter(sweep.axes.items()))
    colours = colormaps["viridis"](np.linspace(0, 0.9, len(values)))
    scales = {"sinkage": -label_channel(above, "z"), "x": label_channel(below, "x")}
    for place, (value, colour) in enumerate(zip(values.tolist(), colours, strict=True)):
        for axes, channel in ((above, "sinkage"), (below, "x")):
            rows = scales[channel] * sweep[channel][place].reshape(-1, len(sweep.time))
            shown = f"{value:.4g}" if isinstance(value, float) else f"{value}"
            axes.plot(sweep.time, rows.T, color=colour, lw=1.2, label=f"{name} {shown}")
    handles, labels = above.get_legend_handles_labels()
    first = dict(zip(reversed(labels), reversed(handles), strict=True))
    above.legend([*first.values()][::-1], [*first][::-1])
    below.set_xlabel("time [s]")
    title_above(figure, sweep.setup.title)
    return figure


@project_style
def slip_figure(steady: SteadyState) -> Figure:
    """Drawbar pull, sinkage and torque over slip; open where the wheel was not steady."""
    figure = Figure(figsize=(STYLE.width, 6), layout="constrained")
    slip, is_steady = np.atleast_1d(steady.slip), np.atleast_1d(steady.is_steady)
    order = np.argsort(slip)
    pull, sinkage, torque = figure.subplots(3, 1, sharex=True)
    pull.set_ylabel("drawbar pull [N]")
    scales = (1.0, -label_channel(sinkage, "z"), label_channel(torque, "torque"))
    names = ("drawbar_pull", "sinkage", "torque")
    for axes, name, scale in zip((pull, sinkage, torque), names, scales, strict=True):
        values = scale * np.atleast_1d(getattr(steady, name))
        colour = SIMULATED.colour
        axes.plot(slip[order], values[order], **SIMULATED.line)
        axes.plot(slip[is_steady], values[is_steady], "o", color=colour)
        axes.plot(slip[~is_steady], values[~is_steady], "o", color=colour, markerfacecolor="none")
    torque.set_xlabel("slip [-]")
    title_above(figure, f"{steady.title}, omega {steady.omega:.4g} rad/s")
    return figure
