"""Figures of sweeps and of slip curves, without a window."""

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from drftjax.sweeps.parameter_sweep import ParameterSweep
from drftjax.sweeps.steady_state import SteadyState


def sweep_figure(sweep: ParameterSweep) -> Figure:
    """Sinkage and travel of every run over time, coloured by the first number swept."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    name, values = next(iter(sweep.axes.items()))
    colours = colormaps["viridis"](np.linspace(0, 0.9, len(values)))
    for place, (value, colour) in enumerate(zip(values.tolist(), colours, strict=True)):
        for axes, channel, scale in ((above, "sinkage", 1e3), (below, "x", 1.0)):
            rows = scale * sweep[channel][place].reshape(-1, len(sweep.time))
            shown = f"{value:.4g}" if isinstance(value, float) else f"{value}"
            axes.plot(sweep.time, rows.T, color=colour, lw=1, label=f"{name} {shown}")
    handles, labels = above.get_legend_handles_labels()
    first = dict(zip(reversed(labels), reversed(handles), strict=True))
    above.legend([*first.values()][::-1], [*first][::-1], fontsize="small")
    above.set_ylabel("sinkage [mm]")
    below.set_ylabel("x [m]")
    below.set_xlabel("time [s]")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    figure.suptitle(sweep.setup.title.replace("$", r"\$"), fontsize="medium")
    return figure


def slip_figure(steady: SteadyState) -> Figure:
    """Drawbar pull, sinkage and torque over slip; open where the wheel was not steady."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    panels = (
        ("drawbar_pull", "drawbar pull [N]", 1.0),
        ("sinkage", "sinkage [mm]", 1e3),
        ("torque", "torque [N m]", 1.0),
    )
    slip, is_steady = np.atleast_1d(steady.slip), np.atleast_1d(steady.is_steady)
    order = np.argsort(slip)
    every = figure.subplots(3, 1, sharex=True)
    for axes, (name, label, scale) in zip(every, panels, strict=True):
        values = scale * np.atleast_1d(getattr(steady, name))
        axes.plot(slip[order], values[order], color="C0")
        axes.plot(slip[is_steady], values[is_steady], "o", color="C0")
        axes.plot(slip[~is_steady], values[~is_steady], "o", color="C0", markerfacecolor="none")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    every[-1].set_xlabel("slip [-]")
    title = f"{steady.title}, omega {steady.omega:.4g} rad/s"
    figure.suptitle(title.replace("$", r"\$"), fontsize="medium")
    return figure
