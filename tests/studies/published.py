"""Measured: published single-wheel tests, sinkage, drawbar pull and torque over slip.

    python -m tests.studies.published [--data FOLDER]

`tests/studies/published_wheels.py` reads and simulates them.
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from drftjax.common.jax_config import configure_jax
from drftjax.physics.stress import ArcBisector
from tests.studies.cmu import MM, WIDTH, table
from tests.studies.published_wheels import (
    CARRIAGE_SPEED,
    Reading,
    WheelTest,
    arc_change,
    arc_speed,
    at_measured_sinkage,
    at_one_zeta,
    bare,
    default_folder,
    grouser_readings,
    grousered,
    height_decrease,
    one_zeta,
    shadowed,
    true_wheel,
    wheel_tests,
    with_cohesion,
)

# The arc's bisector is less than 0.1 mm from the vertical at 10 mm/s; these plates tell them apart.
FINE_PLATE_SIZE = 2e-5
# Depths whose stress a cohesion is given [m].
COHESIVE_DEPTHS = (0.0, 0.002, 0.005, 0.010, 0.030)
# Shares of the lugs' height that are tried [-].
SHARES = (0.25, 0.3, 1 / 3, 0.4, 0.5, 0.6, 0.8, 1.0)
# Grousers of KLS-1 by its spacing of 36 degrees; the table says 16.
KLS_BY_SPACING = 10


def summary_table(tests: dict[str, WheelTest]) -> Table:
    """One zeta of each wheel, and its errors beside the scatter of the rows about their mean."""
    title = "One zeta per wheel, fitted to the sinkage of all of its rows: RMSE (sd of the rows)"
    own_columns = ("own zetas: Fx N", "T N m")
    made = table(
        title, "wheel", "rows", "plate's zeta", "zeta", "H mm", "Fx N", "T N m", *own_columns
    )
    for name, test in tests.items():
        fit, own = one_zeta(true_wheel(test), test), at_measured_sinkage(true_wheel(test), test)
        spread = (test.sinkage.std() * MM, test.forward.std(), test.torque.std())
        sinkage, forward, torque = fit.errors(test)
        errors = zip((sinkage * MM, forward, torque), spread, strict=True)
        _, own_forward, own_torque = own.errors(test)
        made.add_row(
            name,
            str(test.slip.size),
            f"{test.plate_zeta:.2f}",
            f"{fit.zeta[0]:.2f}",
            *(_number(error, f"{error:.2f} ({sd:.2f})") for error, sd in errors),
            f"{own_forward:.2f}",
            _number(own_torque, f"{own_torque:.2f}"),
        )
    return made


def _number(value: float, text: str) -> str:
    return text if np.isfinite(value) else "-"


def rows_table(test: WheelTest, reading: Reading) -> Table:
    """Every row: measured, at one zeta, and at the zeta that it needs by itself."""
    fit, own = one_zeta(reading, test), at_measured_sinkage(reading, test)
    title = f"{test.name} ({reading.name}): measured; at one zeta {fit.zeta[0]:.2f}; at its own"
    forces = ("Fx N", "one", "own", "T N m", "one", "own")
    made = table(title, "slip", "H mm", "one", "zeta needed", *forces)
    for i, slip in enumerate(test.slip):
        made.add_row(
            f"{slip:g}",
            f"{test.sinkage[i] * MM:.1f}",
            f"{fit.sinkage[i] * MM:.1f}",
            f"{own.zeta[i]:.2f}",
            f"{test.forward[i]:.1f}",
            f"{fit.forward[i]:.1f}",
            f"{own.forward[i]:.1f}",
            _number(test.torque[i], f"{test.torque[i]:.1f}"),
            f"{fit.torque[i]:.2f}",
            f"{own.torque[i]:.2f}",
        )
    return made


def needed_table(test: WheelTest) -> Table:
    """The zeta that each slip needs, and one zeta's errors, by the ways to read a wheel's rows."""
    ways = grouser_readings(test)
    made = table(f"{test.name}: zeta that each row needs", "slip", *(way.name for way in ways))
    needed = [at_measured_sinkage(way, test).zeta for way in ways]
    for slip, *zetas in zip(test.slip, *needed, strict=True):
        made.add_row(f"{slip:g}", *(f"{zeta:.2f}" for zeta in zetas))
    made.add_section()
    fits = [one_zeta(way, test) for way in ways]
    errors = [fit.errors(test) for fit in fits]
    made.add_row("one zeta", *(f"{fit.zeta[0]:.2f}" for fit in fits))
    made.add_row("RMSE H mm", *(f"{error[0] * MM:.2f}" for error in errors))
    made.add_row("RMSE Fx N", *(f"{error[1]:.1f}" for error in errors))
    made.add_row("RMSE T N m", *(_number(error[2], f"{error[2]:.2f}") for error in errors))
    return made


def arc_table(tests: dict[str, WheelTest]) -> Table:
    """Largest change by the arc's bisector at 10 mm/s, and the speed at which it is 1 mm."""
    title = (
        "Arc's bisector against the vertical's at one zeta: largest change of any row at 10 mm/s"
    )
    first = ("1 mm of H at mm/s", "slip", "delta_h mm")
    made = table(title, "wheel", "delta_h mm", "H um", "Fx N", "T N m", "zeta", *first)
    for name, test in tests.items():
        zeta = float(one_zeta(true_wheel(test), test).zeta[0])
        refitted = float(one_zeta(true_wheel(test, ArcBisector()), test).zeta[0])
        change = arc_change(test, zeta)
        speed, row = arc_speed(test, zeta)
        made.add_row(
            name,
            f"{height_decrease(test).max() * MM:.3f}",
            f"{np.abs(change.sinkage).max() * 1e6:.1f}",
            f"{np.abs(change.forward).max():.3f}",
            f"{np.abs(change.torque).max():.4f}",
            f"{refitted - zeta:+.3f}",
            f"{speed * MM:.0f}",
            f"{test.slip[row]:g}",
            f"{height_decrease(test, speed)[row] * MM:.1f}",
        )
    return made


def shares_table(tests: dict[str, WheelTest]) -> Table:
    """Errors at one zeta by the share of the lugs' height."""
    title = "One zeta, by the share of the lugs' height: RMSE of H mm, Fx N, T N m"
    made = table(title, "wheel", *(f"{share:.2f}" for share in SHARES))
    for name, test in tests.items():
        if not test.grouser_count:
            continue
        cells = []
        for share in SHARES:
            sinkage, forward, torque = one_zeta(grousered(test, fraction=share), test).errors(test)
            cells.append(f"{sinkage * MM:.1f}, {forward:.1f}, " + _number(torque, f"{torque:.2f}"))
        made.add_row(name, *cells)
    return made


def largest_by_speed(tests: dict[str, WheelTest]) -> float:
    """Largest change of any sinkage [m] by half and twice the carriage's speed, at one zeta."""
    changes = []
    for test in tests.values():
        reading = true_wheel(test)
        zeta = float(one_zeta(reading, test).zeta[0])
        at = at_one_zeta(reading, test, zeta).sinkage
        changes += [
            np.abs(at_one_zeta(reading, test, zeta, factor * CARRIAGE_SPEED).sinkage - at).max()
            for factor in (0.5, 2.0)
        ]
    return float(max(changes))


def cohesion_table(tests: dict[str, WheelTest]) -> Table:
    """One zeta, its error of sinkage, and the fall of the needed zeta, by cohesion."""
    title = "With the stress of a further depth: one zeta, RMSE of H mm, largest over last own zeta"
    made = table(title, "wheel", *(f"{depth * MM:g} mm" for depth in COHESIVE_DEPTHS))
    for name, test in tests.items():
        cells = []
        for depth in COHESIVE_DEPTHS:
            reading = with_cohesion(true_wheel(test), depth)
            fit, own = one_zeta(reading, test), at_measured_sinkage(reading, test)
            fall = own.zeta.max() / own.zeta[-1]
            cells.append(f"{fit.zeta[0]:.2f}, {fit.errors(test)[0] * MM:.2f}, {fall:.1f}")
        made.add_row(name, *cells)
    return made


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=default_folder())
    options = parser.parse_args()
    configure_jax()
    console = Console()
    if console.width < WIDTH:
        console = Console(width=WIDTH)

    tests = wheel_tests(options.data)
    console.print(summary_table(tests))
    for test in tests.values():
        console.print(rows_table(test, true_wheel(test)))
    for test in tests.values():
        if test.grouser_count:
            console.print(needed_table(test))
            console.print(rows_table(test, shadowed(test)))
    smooth, lugs = tests["Ding, smooth"], tests["Ding, 30 lugs"]
    zeta = float(one_zeta(true_wheel(smooth), smooth).zeta[0])
    for way in (true_wheel(lugs), shadowed(lugs)):
        errors = at_one_zeta(way, lugs, zeta).errors(lugs)
        console.print(
            f"Ding, 30 lugs ({way.name}) at the smooth wheel's zeta {zeta:.2f}: RMSE "
            f"{errors[0] * MM:.2f} mm, {errors[1]:.1f} N, {errors[2]:.2f} N m."
        )
    console.print(arc_table(tests))
    fine = arc_change(smooth, zeta, make=partial(bare, plate_size=FINE_PLATE_SIZE))
    console.print(
        f"Ding, smooth, plates of {FINE_PLATE_SIZE * MM:g} mm: at 10 mm/s the arc moves H by at "
        f"most {np.abs(fine.sinkage).max() * 1e6:.2f} um."
    )
    console.print(cohesion_table(tests))
    console.print(shares_table(tests))
    console.print(
        "At half and twice the carriage's speed no sinkage moves by more than "
        f"{largest_by_speed(tests) * MM:.4f} mm."
    )
    kls = replace(tests["KLS-1, grousers"], grouser_count=KLS_BY_SPACING)
    console.print(
        f"KLS-1 with {KLS_BY_SPACING} grousers: RMSE of H "
        f"{one_zeta(true_wheel(kls), kls).errors(kls)[0] * MM:.2f} mm."
    )


if __name__ == "__main__":
    main()
