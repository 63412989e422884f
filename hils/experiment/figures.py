"""Figures of the experiment again: like the paper's figs. 7 and 8, and the ripple's spectra."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hils.experiment.experiment import PAPER_RIPPLE, ExperimentResult
from hils.experiment.spectrum import order

MM = 1e3


COLOURS = {"HILS (sim)": "C0", "HILS (real)": "C1", "DRFT": "C3", "free": "0.2"}


FASTEST_SHOWN = 6.0


def runs_figure(result: ExperimentResult) -> Figure:
    """Like fig. 7: z of HILS (sim) and HILS (real), their difference, and zeta, over time."""
    figure = Figure(figsize=(7.5, 7.5), layout="constrained")
    above, middle, below = figure.subplots(3, 1, sharex=True)
    first = result.hils[0]
    kinds = {"HILS (real)": first.measured, "HILS (sim)": first.simulated}
    for name, path in kinds.items():
        above.plot(result.time, MM * path.z, color=COLOURS[name], lw=1.0, label=name)
    above.set_ylabel("z [mm]")
    above.set_title(f"the first of {len(result.hils)} runs", fontsize=9)
    above.legend(fontsize=8)
    for each in result.hils:
        middle.plot(result.time, MM * each.error, color="C0", lw=0.6, alpha=0.6)
        below.plot(result.time, each.zeta, color="C2", lw=0.8, alpha=0.7)
    tolerance = tuner_tolerance(result)
    for side in (-tolerance, tolerance):
        middle.axhline(MM * side, color="0.4", lw=0.7, ls="--")
    middle.set_ylabel("z, sim - real [mm]")
    middle.set_title("all runs; dashed: the dead band", fontsize=9)
    below.set_ylabel("zeta [-]")
    below.set_xlabel("time [s]")
    return figure


def trajectory_figure(result: ExperimentResult) -> Figure:
    """Like fig. 8: mean trajectories z(x), and the band of the free runs."""
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    means, apart = result.means(), result.distances()
    free = means["free"]
    # Runs are compared at equal time, and drawn at the mean travel of that time.
    heights = MM * np.array([each.measured.z for each in result.free])
    band = heights.min(axis=0), heights.max(axis=0)
    axes.fill_between(free.x, *band, color="0.2", alpha=0.15, lw=0, label="free, all runs")
    for name, path in means.items():
        far = f", {MM * apart[name].plane:.1f} mm away" if name in apart else ""
        style = "--" if name == "HILS (real)" else "-"
        axes.plot(path.x, MM * path.z, style, color=COLOURS[name], lw=1.2, label=f"{name}{far}")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("z [mm]")
    axes.set_title(f"means of {len(result.hils)} HILS and {len(result.free)} free runs", fontsize=9)
    axes.legend(fontsize=8)
    return figure


def ripple_figure(result: ExperimentResult) -> Figure:
    """Amplitude spectra at the steady speed, mean over the HILS runs."""
    _, top = result.steady_stretch()
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for name, found in result.spectra().items():
        shown = found.frequency <= FASTEST_SHOWN
        axes, scale = (below, 1.0) if name == "zeta" else (above, 1e6)
        axes.plot(found.frequency[shown], scale * found.amplitude[shown], lw=1.0, label=name)
    above.set_ylabel("amplitude [µm]")
    below.set_ylabel("amplitude of zeta [-]")
    below.set_xlabel("frequency [Hz]")
    for axes in (above, below):
        axes.set_yscale("log")
        mark_frequencies(axes, result)
        axes.legend(fontsize=8)
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
    axes.axvline(PAPER_RIPPLE, color="k", lw=0.8, ls="--", label=f"the paper's {PAPER_RIPPLE} Hz")


def tuner_tolerance(result: ExperimentResult) -> float:
    """The tuner's dead band [m]; 0 where it has none."""
    loop = result.experiment.loop
    return float(getattr(loop.tuner.build(loop.tick), "tolerance", 0.0))
