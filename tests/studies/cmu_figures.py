"""Figures of the study of the CMU single-wheel data."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tests.studies import cmu_data as data
from tests.studies import cmu_driving as driving
from tests.studies import cmu_intrusion as intrusion

MM = 1e3
SIZE = (9.0, 3.6)


def draw(
    folder: Path,
    rows: dict[str, data.SteadyRows],
    smooth_fit: driving.OneZeta,
    grouser_fits: dict[str, driving.OneZeta],
    needed: dict[str, data.Reals],
    smooth_needed: data.Reals,
    pushed: list[data.Intrusion],
    timed: dict[str, list[data.Series]],
) -> None:
    """Write every figure as a PNG file."""
    folder.mkdir(parents=True, exist_ok=True)
    fits = {
        data.SMOOTH: {"circle": smooth_fit},
        data.GROUSER: grouser_fits,
    }
    for wheel, by_name in fits.items():
        _save(_driving(rows[wheel], by_name), folder / f"measured_{wheel}.png")
    _save(_needed(rows, smooth_needed, needed), folder / "measured_zeta.png")
    _save(_intrusion(pushed), folder / "measured_intrusion.png")
    _save(_series(timed), folder / "measured_series.png")


def _save(figure, path: Path) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _driving(rows: data.SteadyRows, fits: dict[str, driving.OneZeta]):
    figure, (left, right) = plt.subplots(1, 2, figsize=SIZE, layout="constrained")
    for name, fit in fits.items():
        label = f"{name}, zeta {fit.zeta:.2f}"
        left.plot(rows.slip, (rows.sinkage + fit.sinkage_error) * MM, ".-", label=label)
        right.plot(rows.slip, rows.forward + fit.force_error, ".-", label=label)
    left.plot(rows.slip, rows.sinkage * MM, "ko", mfc="none", label="measured")
    right.plot(rows.slip, rows.forward, "ko", mfc="none", label="measured")
    left.set(xlabel="slip [-]", ylabel="sinkage [mm]")
    right.set(xlabel="slip [-]", ylabel="forward force [N]")
    right.legend(fontsize="x-small")
    return figure


def _needed(rows: dict[str, data.SteadyRows], smooth: data.Reals, grouser: dict[str, data.Reals]):
    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    axes.plot(rows[data.SMOOTH].slip, smooth, "ko-", mfc="none", label="smooth wheel")
    for name, values in grouser.items():
        axes.plot(rows[data.GROUSER].slip, values, ".-", label=f"grousered: {name}")
    axes.set(xlabel="slip [-]", ylabel="zeta that the sinkage needs [-]", ylim=(0, 2.5))
    axes.legend(fontsize="x-small")
    return figure


def _intrusion(runs: list[data.Intrusion]):
    figure, (left, right) = plt.subplots(1, 2, figsize=SIZE, layout="constrained")
    for run in runs:
        depth, force = run.on_grid(intrusion.GRID)
        shown = force > 0.3
        left.loglog(depth[shown] * MM, force[shown], lw=1, label=f"{run.body} {run.name}")
        if run.body.startswith("plate"):
            deep = depth > 1e-3
            zeta = force[deep] / depth[deep] / intrusion.plate_slope(run.diameter)
            right.plot(depth[deep] * MM, zeta, lw=1, label=f"{run.body} {run.name}")
    guide = np.array([2.0, 30.0])
    left.loglog(guide, 2.0 * guide, "k:", label="proportional to depth")
    left.set(xlabel="depth [mm]", ylabel="force [N]")
    right.set(xlabel="depth [mm]", ylabel="zeta that the force needs [-]")
    left.legend(fontsize="xx-small")
    return figure


def _series(timed: dict[str, list[data.Series]]):
    figure, axes = plt.subplots(1, 2, figsize=SIZE, sharey=True, layout="constrained")
    for one, (wheel, runs) in zip(axes, timed.items(), strict=True):
        colours = plt.get_cmap("viridis")
        for run in runs:
            one.plot(
                run.time,
                run.sinkage * MM,
                lw=0.8,
                color=colours((data.setting_of(run.slip) + 1) / 2),
            )
        one.set(xlabel="time [s]", title=f"{wheel} wheel, coloured by slip")
    axes[0].set_ylabel("sinkage [mm]")
    axes[0].invert_yaxis()
    return figure
