"""The CMU single-wheel data (robomechanics/3d-terramechanics, MIT), read by the ready mappings.

Frame of a run log: x forward, z up, sinkage from the rim. Here sinkage is as the tables count it,
from where the wheel's outermost circle, of 62.5 mm on either wheel, is taken to touch the sand.
"""

import math
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drftjax.runlog.importers.mapped_runs import import_table
from drftjax.runlog.importers.readers.delimited import read_delimited
from drftjax.runlog.record import RunLog

ROOT = Path(__file__).resolve().parents[2]
MAPPINGS = ROOT / "data" / "import"

SMOOTH, GROUSER = "smooth", "grouser"
WHEELS = (SMOOTH, GROUSER)

OUTER_RADIUS = 0.0625
GROUSER_HEIGHT = 0.005
# Nominal rim speeds differ by far more than this, their measured means by far less.
SLIP_TOLERANCE = 0.01

Reals = NDArray[np.float64]


def default_folder() -> Path:
    """Where the data lie: measured/cmu in the folder `shared` beside the repository."""
    return ROOT.parent / "shared" / "measured" / "cmu"


@dataclass(frozen=True)
class SteadyRows:
    """Steady means of straight driving, by rising slip; all of shape (rows,).

    Attributes:
        vx: Carriage speed [m/s].
        omega: Wheel speed by the mapping, rim speed over 62.5 mm [rad/s].
        load: Upward force of the sand on the wheel, each row's own [N].
        sinkage: From the table's zero [m].
        forward: Forward force of the sand on the wheel [N].
    """

    vx: Reals
    omega: Reals
    load: Reals
    sinkage: Reals
    forward: Reals

    @cached_property
    def slip(self) -> Reals:
        """1 - vx / rim where driven, rim / vx - 1 where braked [-]; rim at 62.5 mm."""
        rim = self.omega * OUTER_RADIUS
        driven = rim >= self.vx
        return np.where(driven, 1 - self.vx / np.where(driven, rim, 1), rim / self.vx - 1)

    @cached_property
    def nominal(self) -> Reals:
        """The setting a row belongs to: its slip to a tenth, -0.7 and 0.75 as they are [-]."""
        settings = np.array([-1, -0.7, -0.5, -0.2, 0, 0.2, 0.5, 0.75, 0.9])
        return settings[np.abs(self.slip[:, None] - settings).argmin(1)]

    def between(self, low: float, high: float) -> NDArray[np.bool_]:
        """Rows of settings from `low` to `high`, both included."""
        return (self.nominal >= low - SLIP_TOLERANCE) & (self.nominal <= high + SLIP_TOLERANCE)


def steady_runs(folder: Path, wheel: str) -> list[RunLog]:
    """The steady means of one wheel as run logs."""
    return import_table(folder / f"all_{wheel}_data.csv", MAPPINGS / f"cmu_{wheel}_steady.toml")


def steady_rows(folder: Path, wheel: str) -> SteadyRows:
    """The steady means of one wheel as columns."""
    runs = steady_runs(folder, wheel)
    below_rim = GROUSER_HEIGHT if wheel == GROUSER else 0.0

    def column(take) -> Reals:
        return np.array([float(take(run)) for run in runs])

    rows = SteadyRows(
        vx=column(lambda run: run.command.vx[0]),
        omega=column(lambda run: run.command.omega[0]),
        load=column(lambda run: run.measured.fz[0]),
        sinkage=column(lambda run: run.measured.sinkage[0]) + below_rim,
        forward=column(lambda run: run.measured.fx[0]),
    )
    order = np.argsort(rows.slip)
    return SteadyRows(
        *(getattr(rows, name)[order] for name in ("vx", "omega", "load", "sinkage", "forward"))
    )


@dataclass(frozen=True)
class TableCount:
    """How many rows a table has, and how many of them say the same.

    Attributes:
        rows: Rows of the table.
        straight: Rows at slip angle 0.
        identical: Rows that repeat an earlier one in every number.
        same_label: Rows that repeat an earlier one's rim speed, slip angle and trial number.
        straight_label: The same, of the rows at slip angle 0.
    """

    rows: int
    straight: int
    identical: int
    same_label: int
    straight_label: int


def table_count(folder: Path, wheel: str) -> TableCount:
    """Count a table of steady means as it stands in the file."""
    table = read_delimited(folder / f"all_{wheel}_data.csv")[0]
    straight = table.numbers("beta") == 0
    labels = list(zip(*(table.cells(name) for name in ("Vry", "beta", "trial_num")), strict=True))
    of_straight = [label for label, keep in zip(labels, straight, strict=True) if keep]
    numbers = list(zip(*(table.cells(name) for name in table.headings[3:]), strict=True))
    return TableCount(
        rows=len(table),
        straight=int(straight.sum()),
        identical=_repeats(numbers),
        same_label=_repeats(labels),
        straight_label=_repeats(of_straight),
    )


def _repeats(items: list) -> int:
    return sum(count - 1 for count in Counter(items).values())


@dataclass(frozen=True)
class Intrusion:
    """One slow vertical intrusion.

    Attributes:
        body: plate_d60mm, plate_d80mm, plate_d100mm, wheel_smooth or wheel_grouser.
        name: The run's own name.
        depth: From the file's zero [m].
        force: Upward force of the sand [N].
    """

    body: str
    name: str
    depth: Reals
    force: Reals

    @property
    def diameter(self) -> float:
        """Of a round plate [m]."""
        return float(self.body.removeprefix("plate_d").removesuffix("mm")) * 1e-3

    def on_grid(self, spacing: float) -> tuple[Reals, Reals]:
        """Depth and force averaged over steps of depth, so that no depth counts twice."""
        cell = np.floor(self.depth / spacing).astype(int)
        count = np.bincount(cell)
        held = count > 0
        depth = np.bincount(cell, self.depth)[held] / count[held]
        return depth, np.bincount(cell, self.force)[held] / count[held]


def intrusions(folder: Path) -> list[Intrusion]:
    """Every vertical intrusion, plates by size first, then the wheels."""
    found = []
    for path in sorted((folder / "processed_intrusion").glob("*.csv")):
        table = read_delimited(path)[0]
        words = path.stem.split("_")
        body = "_".join(words[-2:])
        name = "_".join(words[1:-2]).replace("force-displacement_", "")
        found.append(Intrusion(body, name, table.numbers("sinkage_m"), table.numbers("Fz_N")))
    return sorted(found, key=lambda each: (each.body[0], len(each.body), each.body, each.name))


@dataclass(frozen=True)
class Series:
    """One run in time, from 40 s to 75 s where it is clean.

    Attributes:
        name: The run's own name.
        start: Sinkage in the first row of all, long before 40 s [m].
        time: From 40 s on [s].
        vx: Mean carriage speed that was logged [m/s].
        travel: Carriage speed by its travel, the slope of x [m/s].
        rim_speed: Mean rim speed [m/s].
        rim: Rim speed over time [m/s].
        sinkage: From the table's zero [m].
    """

    name: str
    start: float
    time: Reals
    vx: float
    travel: float
    rim_speed: float
    rim: Reals
    sinkage: Reals

    @property
    def slip(self) -> float:
        """As in `SteadyRows` [-]."""
        if self.rim_speed >= self.vx:
            return 1 - self.vx / self.rim_speed
        return self.rim_speed / self.vx - 1

    def resampled(self, values: Reals, interval: float = 0.02) -> tuple[Reals, Reals]:
        """Values at even times."""
        time = np.arange(self.time[0], self.time[-1], interval)
        return time, np.interp(time, self.time, values)

    @property
    def ripple(self) -> float:
        """Standard deviation of the sinkage about a parabola in time [m]."""
        time, sinkage = self.resampled(self.sinkage)
        return float(np.std(sinkage - np.polyval(np.polyfit(time, sinkage, 2), time)))

    @property
    def rise(self) -> float:
        """Share of the sinkage's changes that go up [-]."""
        change = np.diff(self.sinkage)
        return float((change < 0).sum() / max(1, (change != 0).sum()))


def drive_line(runs: list[Series]) -> float:
    """Frequency of the drive's own unevenness per rim speed, the runs' spectra averaged [1/m].

    It tells how many turns of the drive the rim speed was set to stand for, and so whether both
    wheels' rim speeds were set by one radius.
    """
    order = np.arange(90.0, 125.0, 0.25)
    power = np.zeros_like(order)
    for run in runs:
        time, rim = run.resampled(run.rim)
        rim = (rim - rim.mean()) * np.hanning(rim.size)
        phase = 2j * np.pi * order[:, None] * run.rim_speed * (time - time[0])
        each = np.abs(np.exp(phase) @ rim) ** 2
        power += each / np.median(each)
    return float(order[power.argmax()])


def series(folder: Path, wheel: str) -> list[Series]:
    """Every run in time of one wheel, in the order of the table."""
    table = read_delimited(folder / "processed_timeseries" / f"beta0_{wheel}.csv.gz")[0]
    names = np.array(table.cells("run"))
    columns = {name: table.numbers(name) for name in table.headings if name != "run"}
    found = []
    for name in dict.fromkeys(names.tolist()):
        here = np.flatnonzero(names == name)
        clean = here[(columns["t_s"][here] >= 40) & (columns["t_s"][here] <= 75)]
        time, travel = columns["t_s"][clean], columns["x_mm"][clean] * 1e-3
        rim = columns["vry_mm_s"][clean] * 1e-3
        found.append(
            Series(
                name=name,
                start=float(columns["sinkage_mm"][here[0]]) * 1e-3,
                time=time,
                vx=float(columns["vx_mm_s"][clean].mean()) * 1e-3,
                travel=float(np.polyfit(time, travel, 1)[0]),
                rim_speed=float(rim.mean()),
                rim=rim,
                sinkage=columns["sinkage_mm"][clean] * 1e-3,
            )
        )
    return found


def setting_of(slip: float) -> float:
    """The nominal slip that a run in time belongs to [-]."""
    settings = (-1.0, -0.7, -0.5, -0.2, 0.0, 0.2, 0.5, 0.75, 0.9)
    return min(settings, key=lambda each: math.fabs(each - slip))
