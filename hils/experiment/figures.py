"""Figures of the experiment again: like the paper's figs. 7 and 8, and the ripple's spectra."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drftjax.common.figures import (
    BEFORE,
    COMMANDED,
    REAL,
    SIMULATED,
    STYLE,
    TRUE,
    draw_floor,
    label_channel,
    label_difference,
    project_style,
)
from hils.experiment.experiment import PAPER_RIPPLE, ExperimentResult
from hils.experiment.spectrum import order

# DRFT is the model with nothing tuned; a free run is the truth that the loop ought to repeat.
ROLES = {"HILS (sim)": SIMULATED, "HILS (real)": REAL, "DRFT": BEFORE, "free": TRUE}


FASTEST_SHOWN = 6.0


@project_style
def runs_figure(result: ExperimentResult) -> Figure:
    """Like fig. 7: sinkage of HILS (sim) and HILS (real), their difference, and zeta, over time."""
    figure = Figure(figsize=(STYLE.width, 7.5), layout="constrained")
    above, middle, below = figure.subplots(3, 1, sharex=True)
    first = result.hils[0]
    scale = label_channel(above, "z")
    for name, path in {"HILS (real)": first.measured, "HILS (sim)": first.simulated}.items():
        above.plot(result.time, scale * path.z, **ROLES[name].line, label=name)
    above.set_title(f"the first of {len(result.hils)} runs")
    above.legend()
    scale = label_difference(middle, "z", "sim - real")
    draw_floor(middle, scale * tuner_tolerance(result), "dead band of the tuner")
    for each in result.hils:
        middle.plot(result.time, scale * each.error, color=SIMULATED.colour, lw=0.7, alpha=0.6)
        below.plot(result.time, each.zeta, color=SIMULATED.colour, lw=0.9, alpha=0.7)
    middle.set_title("all runs")
    middle.legend()
    below.set_ylabel("zeta [-]")
    below.set_xlabel("time [s]")
    return figure


@project_style
def trajectory_figure(result: ExperimentResult) -> Figure:
    """Like fig. 8: mean sinkage over the travel, and the band of the free runs."""
    figure = Figure(figsize=(STYLE.width, 4.6), layout="constrained")
    axes = figure.subplots()
    means, apart = result.means(), result.distances()
    free = means["free"]
    scale = label_channel(axes, "z")
    # Runs are compared at equal time, and drawn at the mean travel of that time.
    heights = scale * np.array([each.measured.z for each in result.free])
    band = heights.min(axis=0), heights.max(axis=0)
    colour = ROLES["free"].colour
    axes.fill_between(free.x, *band, color=colour, alpha=0.25, lw=0, label="free, all runs")
    for name, path in means.items():
        far = f", {1e3 * apart[name].plane:.1f} mm away" if name in apart else ""
        axes.plot(path.x, scale * path.z, **ROLES[name].line, label=f"{name}{far}")
    axes.set_xlabel("travel [m]")
    axes.set_title(f"means of {len(result.hils)} HILS and {len(result.free)} free runs")
    axes.legend()
    return figure


@project_style
def ripple_figure(result: ExperimentResult) -> Figure:
    """Amplitude spectra at the steady speed, mean over the HILS runs."""
    _, top = result.steady_stretch()
    figure = Figure(figsize=(STYLE.width, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for name, found in result.spectra().items():
        shown = found.frequency <= FASTEST_SHOWN
        axes, scale = (below, 1.0) if name == "zeta" else (above, 1e6)
        role = next((ROLES[each] for each in ROLES if each in name), COMMANDED)
        axes.plot(found.frequency[shown], scale * found.amplitude[shown], **role.line, label=name)
    above.set_ylabel("amplitude of z [µm]")
    below.set_ylabel("amplitude of zeta [-]")
    below.set_xlabel("frequency [Hz]")
    for axes in (above, below):
        axes.set_yscale("log")
        mark_frequencies(axes, result)
        axes.legend()
    orders = above.secondary_xaxis(
        "top",
        functions=(lambda hertz: order(hertz, top), lambda turns: turns * top / (2 * np.pi)),
    )
    orders.set_xlabel("order of rotation")
    return figure


def mark_frequencies(axes: Axes, result: ExperimentResult) -> None:
    """Lines where the grousers pass, and at the frequency that the paper reports."""
    _, top = result.steady_stretch()
    grousers = result.experiment.rig.wheel.grouser_count * top / (2 * np.pi)
    axes.axvline(grousers, color="0.5", lw=0.8, ls=":", label=f"grousers, {grousers:.2f} Hz")
    axes.axvline(
        PAPER_RIPPLE, color=BEFORE.colour, lw=1, ls="--", label=f"the paper's {PAPER_RIPPLE} Hz"
    )


def tuner_tolerance(result: ExperimentResult) -> float:
    """The tuner's dead band [m]; 0 where it has none."""
    loop = result.experiment.loop
    return float(getattr(loop.tuner.build(loop.tick), "tolerance", 0.0))
