"""Measured: steady driving, intrusion and runs in time of the CMU single-wheel data.

Run from the root of the repository: `python -m tests.studies.cmu [--data FOLDER] [-o FOLDER]`.
"""

import argparse
import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.jax_config import configure_jax
from tests.studies import cmu_data as data
from tests.studies import cmu_driving as driving
from tests.studies import cmu_intrusion as intrusion
from tests.studies.cmu_steady import Setting, fit_zeta, held_sinkage

# zeta that each slip needs by an independent DRFT of one circle, lambda 1, on all of the rows.
INDEPENDENT = {
    data.SMOOTH: {-1: 0.30, -0.5: 0.81, 0: 1.07, 0.2: 1.04, 0.5: 0.95, 0.9: 1.04},
    data.GROUSER: {0: 0.92, 0.2: 0.94, 0.5: 0.84, 0.75: 0.69, 0.9: 0.45},
}
NOMINAL_LOAD = 24.0
# In the runs in time the carriage's travel is this much further than its logged speed says.
TRAVEL_RATIO = 1.028
MM = 1e3
TITLE = {data.SMOOTH: "Smooth", data.GROUSER: "Grousered"}
WIDTH = 130


def table(title: str, *columns: str) -> Table:
    """A table whose first column is text and the others numbers."""
    made = Table(title=title, title_justify="left", title_style="bold")
    for i, name in enumerate(columns):
        made.add_column(name, justify="left" if i == 0 else "right")
    return made


def counts_table(folder: Path) -> Table:
    """What the tables hold."""
    made = table(
        "Rows of the tables",
        "wheel",
        "rows",
        "slip angle 0",
        "runs imported",
        "identical rows",
        "same label",
        "same label, angle 0",
    )
    for wheel in data.WHEELS:
        count = data.table_count(folder, wheel)
        numbers = (
            count.rows,
            count.straight,
            len(data.steady_runs(folder, wheel)),
            count.identical,
            count.same_label,
            count.straight_label,
        )
        made.add_row(wheel, *map(str, numbers))
    return made


def one_zeta_table(title: str, fits: dict[str, driving.OneZeta]) -> Table:
    """Errors of one zeta, by the rows that it was fitted to."""
    made = table(
        title,
        "",
        "n",
        "zeta",
        "H mm: fitted",
        "other driven",
        "0 to 0.9",
        "all",
        "Fx N: fitted",
        "other driven",
        "0 to 0.9",
        "all",
    )
    for name, fit in fits.items():
        parts = (fit.fitted, fit.predicted, fit.driven, np.ones_like(fit.fitted))
        made.add_row(
            name,
            str(fit.fitted.sum()),
            f"{fit.zeta:.3f}",
            *(_rms_of(fit.sinkage_error * MM, part) for part in parts),
            *(_rms_of(fit.force_error, part) for part in parts),
        )
    return made


def _rms_of(values: data.Reals, chosen) -> str:
    return f"{driving.rms(values[chosen]):.2f}" if chosen.any() else "-"


def rows_table(wheel: str, rows: data.SteadyRows, fit: driving.OneZeta, name: str) -> Table:
    """Every setting: measured and simulated sinkage and force."""
    made = table(
        f"{TITLE[wheel]} wheel, means by slip, zeta {fit.zeta:.3f} fitted to slip {name}",
        "slip",
        "n",
        "load N",
        "H measured mm",
        "H simulated mm",
        "Fx measured N",
        "Fx simulated N",
    )
    for each in np.unique(rows.nominal):
        at = rows.nominal == each
        made.add_row(
            f"{each:g}",
            str(at.sum()),
            f"{rows.load[at].mean():.1f}",
            f"{rows.sinkage[at].mean() * MM:.1f}",
            f"{(rows.sinkage + fit.sinkage_error)[at].mean() * MM:.1f}",
            f"{rows.forward[at].mean():.1f}",
            f"{(rows.forward + fit.force_error)[at].mean():.1f}",
        )
    return made


def needed_table(wheel: str, rows: data.SteadyRows, columns: dict[str, data.Reals]) -> Table:
    """The zeta that each slip needs."""
    made = table(
        f"zeta that each slip needs, {TITLE[wheel]} wheel", "slip", "n", "independent", *columns
    )
    for each in np.unique(rows.nominal):
        at = rows.nominal == each
        known = INDEPENDENT[wheel].get(float(each))
        made.add_row(
            f"{each:g}",
            str(at.sum()),
            "-" if known is None else f"{known:.2f}",
            *(f"{values[at].mean():.2f}" for values in columns.values()),
        )
    made.add_section()
    flat = {name: flatness(rows, values) for name, values in columns.items()}
    known = [INDEPENDENT[wheel][s] for s in INDEPENDENT[wheel] if s >= 0]
    made.add_row(
        "max / min, 0-0.9",
        "",
        f"{max(known) / min(known):.2f}",
        *(f"{value:.2f}" for value in flat.values()),
    )
    return made


def flatness(rows: data.SteadyRows, needed: data.Reals) -> float:
    """Largest over smallest zeta of the settings from slip 0 to 0.9 [-]; 1 is flat."""
    means = [value for slip, value in driving.by_setting(rows, needed).items() if slip > -0.05]
    return max(means) / min(means)


def check_table(wheel: str, checks: list[driving.Check]) -> Table:
    """Simulated with a free axis."""
    made = table(
        f"{TITLE[wheel]} wheel simulated for 20 s, against a held height",
        "step ms",
        "largest difference mm",
        "largest ripple um",
    )
    for each in checks:
        made.add_row(
            f"{each.step * 1e3:g}",
            f"{each.difference * MM:.3f}",
            f"{each.ripple * 1e6:.0f}",
        )
    return made


RANGES = {"all": (0.0, 1.0), "2-10 mm": (0.002, 0.010), "over 10 mm": (0.010, 1.0)}


def plates_table(runs: list[data.Intrusion]) -> list[Table]:
    """zeta and exponent of every plate."""
    zetas = table(
        "Round plates: zeta of F = zeta alpha A d",
        "plate",
        "run",
        "by samples",
        *(f"by depth, {name}" for name in RANGES),
    )
    powers = table(
        "F = c (d / 10 mm)^n, n with its standard error",
        "body",
        "run",
        *(f"n, {name}" for name in RANGES),
        "c N",
        "rms N",
        "n with touch, 2-10 mm",
        "touch mm",
    )
    for run in runs:
        fits = [intrusion.power_law(run, low, high) for low, high in RANGES.values()]
        free = intrusion.power_law(run, *RANGES["2-10 mm"], find_touch=True)
        if run.body.startswith("plate"):
            by_range = [intrusion.proportional_zeta(run, *each) for each in RANGES.values()]
            zetas.add_row(
                run.body,
                run.name,
                f"{intrusion.proportional_zeta(run, samples=True):.3f}",
                *(f"{value:.3f}" for value in by_range),
            )
        powers.add_row(
            run.body,
            run.name,
            *(f"{fit.n:.2f} ± {fit.n_error:.2f}" for fit in fits),
            f"{fits[0].c:.1f}",
            f"{fits[0].rms:.1f}",
            f"{free.n:.2f} ± {free.n_error:.2f}" if run.body.startswith("plate") else "-",
            f"{free.touch * MM:.2f}" if run.body.startswith("plate") else "-",
        )
    return [zetas, powers]


def wheel_intrusion_tables(runs: list[data.Intrusion]) -> list[Table]:
    """zeta of the wheels that were pushed straight down."""
    fits = table(
        "Wheels pushed straight down, one zeta through the statics",
        "wheel",
        "run",
        "geometry",
        "zeta",
        "rms N",
        "zeta with touch",
        "touch mm",
        "rms N ",
    )
    needed = table(
        "zeta that each depth needs, straight down",
        "wheel",
        "run",
        "geometry",
        *(f"{depth * MM:g} mm" for depth in intrusion.DEPTHS),
    )
    for run in runs:
        if run.body.startswith("plate"):
            continue
        smooth = run.body.endswith(data.SMOOTH)
        ways = [driving.circle()] if smooth else driving.readings()[:4]
        for way in ways:
            found = intrusion.wheel_intrusion(run, way.simulator, way.below_rim)
            label = (run.body.removeprefix("wheel_"), run.name, way.name)
            fits.add_row(
                *label,
                f"{found.zeta:.2f}",
                f"{found.rms:.1f}",
                f"{found.free_zeta:.2f}",
                f"{found.touch * MM:.1f}",
                f"{found.free_rms:.1f}",
            )
            needed.add_row(*label, *(f"{value:.2f}" for value in found.zetas))
    return [fits, needed]


@dataclasses.dataclass(frozen=True)
class SeriesSummary:
    """Runs in time at one setting.

    Attributes:
        slip: Nominal [-].
        sinkage: Mean over 70-75 s of each run [m].
        creep: Its rise since 40-45 s [m].
        ripple: About a parabola, of each run [m].
    """

    slip: float
    sinkage: data.Reals
    creep: data.Reals
    ripple: data.Reals


def summarise(runs: list[data.Series]) -> list[SeriesSummary]:
    """Group runs in time by their nominal slip."""
    groups: dict[float, list[data.Series]] = {}
    for run in runs:
        groups.setdefault(data.setting_of(run.slip), []).append(run)
    summaries = []
    for slip in sorted(groups):
        late = np.array([run.sinkage[run.time >= 70].mean() for run in groups[slip]])
        early = np.array([run.sinkage[run.time <= 45].mean() for run in groups[slip]])
        ripple = np.array([run.ripple for run in groups[slip]])
        summaries.append(SeriesSummary(slip, late, late - early, ripple))
    return summaries


def series_setting(runs: list[data.Series]) -> tuple[Setting, data.Reals]:
    """Speeds of runs in time at the nominal load, and their sinkage over 70-75 s [m]."""
    setting = Setting(
        jnp.asarray([run.vx for run in runs]),
        jnp.asarray([run.rim_speed / data.OUTER_RADIUS for run in runs]),
        jnp.full(len(runs), NOMINAL_LOAD),
    )
    return setting, np.array([run.sinkage[run.time >= 70].mean() for run in runs])


def series_table(wheel: str, runs: list[data.Series], reading, zeta: float) -> Table:
    """Scatter, creep and ripple in time, beside the simulated steady sinkage."""
    made = table(
        f"{TITLE[wheel]} wheel in time, 40-75 s; simulated at {NOMINAL_LOAD:g} N, zeta {zeta:.3f}",
        "slip",
        "runs",
        "H 70-75 s mm",
        "scatter sd mm",
        "range mm",
        "simulated mm",
        "creep 40-75 s mm",
        "ripple sd um",
    )
    setting, _ = series_setting(runs)
    simulated = np.asarray(held_sinkage(reading.simulator, setting, jnp.asarray(zeta)))
    simulated = simulated + reading.below_rim
    slips = np.array([data.setting_of(run.slip) for run in runs])
    for each in summarise(runs):
        several = each.sinkage.size > 1
        made.add_row(
            f"{each.slip:g}",
            str(each.sinkage.size),
            f"{each.sinkage.mean() * MM:.1f}",
            f"{each.sinkage.std(ddof=1) * MM:.2f}" if several else "-",
            f"{np.ptp(each.sinkage) * MM:.2f}" if several else "-",
            f"{simulated[slips == each.slip].mean() * MM:.1f}",
            f"{each.creep.mean() * MM:.2f}",
            f"{np.median(each.ripple) * 1e6:.0f}",
        )
    return made


def series_facts(everything: dict[str, list[data.Series]]) -> Table:
    """What the runs in time say of the rig itself."""
    made = table(
        "The rig, by its runs in time",
        "wheel",
        "runs",
        "sinkage in first row mm",
        "changes after 40 s that rise %",
        "travel / vx",
        "drive's own line 1/m",
    )
    for wheel, runs in everything.items():
        starts = sorted({round(run.start * MM, 2) for run in runs})
        ratio = np.array([run.travel / run.vx for run in runs])
        even = [run for run in runs if 4e-3 < run.rim_speed < 25e-3]
        made.add_row(
            wheel,
            str(len(runs)),
            " to ".join(f"{value:g}" for value in dict.fromkeys((starts[0], starts[-1]))),
            f"{np.mean([run.rise for run in runs]) * 100:.0f}",
            f"{ratio.min():.3f} to {ratio.max():.3f}",
            f"{data.drive_line(even):.1f} (n {len(even)})",
        )
    return made


def series_fit(runs: list[data.Series]) -> tuple[int, float, float]:
    """One zeta for the smooth wheel's driven runs in time: their number, zeta, RMSE [m]."""
    runs = [run for run in runs if data.setting_of(run.slip) >= 0]
    setting, sinkage = series_setting(runs)
    simulator = driving.circle().simulator
    held = jnp.asarray(sinkage)
    zeta = fit_zeta(simulator, setting, held, jnp.ones_like(held))
    return (
        len(runs),
        float(zeta),
        driving.rms(np.asarray(held_sinkage(simulator, setting, zeta)) - sinkage),
    )


def main() -> None:
    """Print the tables and, with -o, draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data.default_folder())
    parser.add_argument("-o", "--output", type=Path, help="folder for the figures")
    options = parser.parse_args()
    configure_jax()
    console = Console()
    if console.width < WIDTH:
        console = Console(width=WIDTH)
    folder: Path = options.data

    console.print(counts_table(folder))
    rows = driving.both_tables(folder)
    smooth, grouser = rows[data.SMOOTH], rows[data.GROUSER]
    plain = driving.circle()
    fits = {
        name: driving.one_zeta(plain, smooth, *part) for name, part in driving.FITTED_ON.items()
    }
    further = dataclasses.replace(smooth, vx=smooth.vx * TRAVEL_RATIO)
    shown = fits | {f"0 to 0.9, vx x {TRAVEL_RATIO:g}": driving.one_zeta(plain, further, 0, 0.9)}
    console.print(one_zeta_table("Smooth wheel: one zeta fitted to these slips, RMSE", shown))
    console.print(rows_table(data.SMOOTH, smooth, fits["0 to 0.2"], "0 to 0.2"))
    console.print(rows_table(data.SMOOTH, smooth, fits["0 to 0.9"], "0 to 0.9"))
    smooth_needed = driving.needed_zeta(plain, smooth)
    console.print(needed_table(data.SMOOTH, smooth, {"circle": smooth_needed}))
    terms = driving.dynamic_terms(smooth)
    console.print(
        f"Smooth wheel, slip 0 to 0.9, zeta 1: without lambda the sinkage moves by at most "
        f"{terms.momentum * 1e6:.1f} um, without the height decrease by {terms.height * MM:.2f} mm."
    )
    console.print(
        check_table(data.SMOOTH, driving.check_steady(plain, smooth, fits["0 to 0.9"].zeta))
    )

    ways = driving.readings()
    needed = {way.name: driving.needed_zeta(way, grouser) for way in ways}
    console.print(needed_table(data.GROUSER, grouser, needed))
    driven = {way.name: driving.one_zeta(way, grouser, 0, 0.9) for way in ways}
    console.print(one_zeta_table("Grousered wheel: one zeta fitted to slip 0 to 0.9, RMSE", driven))
    low = {way.name: driving.one_zeta(way, grouser, 0, 0.2) for way in ways}
    console.print(one_zeta_table("Grousered wheel: one zeta fitted to slip 0 to 0.2, RMSE", low))
    true = ways[1]
    console.print(rows_table(data.GROUSER, grouser, driven[true.name], "0 to 0.9"))
    console.print(
        check_table(data.GROUSER, driving.check_steady(true, grouser, driven[true.name].zeta))
    )

    pushed = data.intrusions(folder)
    for each in (*plates_table(pushed), *wheel_intrusion_tables(pushed)):
        console.print(each)

    timed = {wheel: data.series(folder, wheel) for wheel in data.WHEELS}
    console.print(series_facts(timed))
    console.print(series_table(data.SMOOTH, timed[data.SMOOTH], plain, fits["0 to 0.9"].zeta))
    console.print(series_table(data.GROUSER, timed[data.GROUSER], true, driven[true.name].zeta))
    count, zeta, error = series_fit(timed[data.SMOOTH])
    console.print(
        f"Smooth wheel in time: one zeta {zeta:.3f} over {count} runs of slip 0 to 0.9 at "
        f"{NOMINAL_LOAD:g} N leaves {error * MM:.2f} mm."
    )

    if options.output is not None:
        from tests.studies.cmu_figures import draw

        draw(options.output, rows, fits["0 to 0.9"], driven, needed, smooth_needed, pushed, timed)


if __name__ == "__main__":
    main()
