"""Published single-wheel tests, and their rows simulated.

Readings of figures of Ding et al. 2011 (J. Terramechanics 48:27), Wang & Han 2016 (J. Korean
Geotech. Soc. 32(11):97) and Hurrell et al. 2025 (Space Sci. Rev. 221:37), digitised by others.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from drftjax.effects.stress import Cohesion
from drftjax.physics.stress import AbstractBisector, ArcBisector, Dynamic, StressCoefficients
from drftjax.physics.wheel import AbstractWheel, GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator
from tests.studies.cmu_data import Reals
from tests.studies.cmu_driving import rms
from tests.studies.cmu_steady import (
    BULK_DENSITY,
    GRAVITY,
    LAMBDA,
    Setting,
    driven,
    fit_zeta,
    held_force,
    held_sinkage,
)

ROOT = Path(__file__).resolve().parents[2]
# In the table for Wang & Han; of the others it is assumed [m/s].
CARRIAGE_SPEED = 0.010
# In the table for Wang & Han; of the others it is assumed [m].
THICKNESS = 0.003
PLATE_SIZE = 1e-3
# Depth at which a plate's Bekker pressure is turned into a zeta: amid the sinkages [m].
PLATE_DEPTH = 0.010
# By label in the table: name for print.
WHEELS = {
    "ding2011_smooth_w80": "Ding, smooth",
    "ding2011_lug10_w80": "Ding, 30 lugs",
    "kls1_smooth_w59": "KLS-1, smooth",
    "kls1_lug10_w59": "KLS-1, grousers",
    "rashid1_fjs1_w24": "FJS-1, Rashid-1",
}


@dataclass(frozen=True)
class WheelTest:
    """Rows of one wheel by rising slip; columns of shape (rows,).

    Attributes:
        name: Sand and wheel.
        radius, width: Of the rim [m].
        grouser_count, grouser_height: 0 for a smooth wheel; height [m].
        plate_zeta: zeta of a flat plate at 10 mm, by the sand's Bekker constants [-].
        slip: [-].
        load: Vertical load [N].
        sinkage: From the table's zero [m].
        forward: Drawbar pull, mean forward force of the sand on the wheel [N].
        torque: Drive torque [N m]; not a number where it was not measured.
    """

    name: str
    radius: float
    width: float
    grouser_count: int
    grouser_height: float
    plate_zeta: float
    slip: Reals
    load: Reals
    sinkage: Reals
    forward: Reals
    torque: Reals


def default_folder() -> Path:
    """Where the data lie: measured/published in the folder `shared` beside the repository."""
    return ROOT.parent / "shared" / "measured" / "published"


def wheel_tests(folder: Path) -> dict[str, WheelTest]:
    """The tests of `WHEELS`, by name."""
    soils = {row["simulant"]: row for row in _read(folder / "soil_simulants.csv")}
    rows = _read(folder / "single_wheel_experiments.csv")
    rows.sort(key=lambda row: float(row["slip"]))
    groups: dict[str, list[dict[str, str]]] = {name: [] for name in WHEELS.values()}
    for row in rows:
        groups[WHEELS[row["case_id"].rpartition("_")[0]]].append(row)
    return {name: _wheel_test(name, group, soils) for name, group in groups.items()}


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _wheel_test(
    name: str, rows: list[dict[str, str]], soils: dict[str, dict[str, str]]
) -> WheelTest:
    def column(key: str) -> Reals:
        return np.array([float(row[key] or "nan") for row in rows])

    width = float(rows[0]["wheel_width_m"])
    return WheelTest(
        name,
        float(rows[0]["wheel_radius_m"]),
        width,
        int(rows[0]["grouser_count"]),
        float(rows[0]["grouser_height_m"]),
        plate_zeta(soils[rows[0]["soil_simulant"]], width),
        column("slip"),
        column("vertical_load_n"),
        column("meas_sinkage_m"),
        column("meas_drawbar_pull_n"),
        column("meas_torque_nm"),
    )


def plate_zeta(soil: dict[str, str], width: float) -> float:
    """zeta [-] by which a flat plate at `PLATE_DEPTH` has the pressure of Bekker's formula.

    Args:
        soil: Its row of the table, with k_c [kN/m^(n+1)], k_phi [kN/m^(n+2)] and n.
        width: Of the plate [m].
    """
    stiffness = float(soil["k_c_kN_per_m_n_plus_1"]) / width + float(
        soil["k_phi_kN_per_m_n_plus_2"]
    )
    pressure = 1e3 * stiffness * PLATE_DEPTH ** float(soil["n"])
    down, zero = jnp.asarray(-1.0), jnp.asarray(0.0)
    _, alpha = StressCoefficients.generic()(zero, down, zero, down)
    return pressure / (1e6 * float(alpha) * PLATE_DEPTH)


@dataclass(frozen=True)
class Reading:
    """A way to read a wheel's rows: which wheel is simulated, and what its columns mean.

    Attributes:
        name: For tables.
        simulator: The wheel on the sand.
        below_rim: Height of the simulated rim over the circle that sinkage counts from [m].
        slip_radius: Radius whose speed the slip compares with the carriage's [m].
    """

    name: str
    simulator: Simulator
    below_rim: float
    slip_radius: float

    def setting(self, test: WheelTest, speed: float = CARRIAGE_SPEED) -> Setting:
        """Speeds and loads of the rows, at a carriage speed [m/s]."""
        omega = speed / (1 - test.slip) / self.slip_radius
        return Setting(jnp.full_like(omega, speed), jnp.asarray(omega), jnp.asarray(test.load))


def bare(
    test: WheelTest, bisector: AbstractBisector | None = None, *, plate_size: float = PLATE_SIZE
) -> Reading:
    """A bare rim: the smooth wheel, or a grousered one without its grousers."""
    wheel = PlainWheel(test.radius, test.width, plate_size=plate_size)
    return _reading("bare rim", test, wheel, bisector)


def grousered(
    test: WheelTest,
    bisector: AbstractBisector | None = None,
    *,
    thickness: float = THICKNESS,
    fraction: float = 1.0,
) -> Reading:
    """A wheel with its grousers, which are `thickness` [m] thick, at `fraction` of their height."""
    wheel = GrouserWheel(
        test.radius,
        test.width,
        test.grouser_count,
        test.grouser_height,
        thickness,
        fraction,
        plate_size=2 * PLATE_SIZE,
    )
    return _reading("rim, 3 mm", test, wheel, bisector)


def _reading(
    name: str, test: WheelTest, wheel: AbstractWheel, bisector: AbstractBisector | None
) -> Reading:
    law = Dynamic(LAMBDA, BULK_DENSITY)
    law = law if bisector is None else replace(law, bisector=bisector)
    return Reading(name, driven(wheel, law), 0.0, test.radius)


def true_wheel(test: WheelTest, bisector: AbstractBisector | None = None) -> Reading:
    """The wheel as it was, its sinkage and its slip counted by the rim."""
    return (grousered if test.grouser_count else bare)(test, bisector)


def shadowed(test: WheelTest) -> Reading:
    """A grousered wheel by the shadowing rule of Agarwal et al. 2021: a third of the height."""
    return replace(grousered(test, fraction=1 / 3), name="height / 3")


def with_cohesion(reading: Reading, depth: float) -> Reading:
    """The same with the stress of a further `depth` [m] everywhere below ground."""
    simulator = replace(reading.simulator, effects=(Cohesion(depth),))
    return replace(reading, simulator=simulator)


def grouser_readings(test: WheelTest) -> list[Reading]:
    """Ways to read the rows of a grousered wheel."""
    plain = grousered(test)
    height = test.grouser_height
    return [
        plain,
        replace(grousered(test, thickness=1e-3), name="rim, 1 mm"),
        replace(grousered(test, thickness=6e-3), name="rim, 6 mm"),
        replace(plain, name="slip by tips", slip_radius=test.radius + height),
        shadowed(test),
        bare(test),
        replace(plain, name="tips, 3 mm", below_rim=height),
    ]


@dataclass(frozen=True)
class Simulated:
    """Steady driving as simulated; columns of shape (rows,).

    Attributes:
        zeta: Scaling factor [-], of every row.
        sinkage: From the table's zero [m].
        forward: Drawbar pull [N].
        torque: Drive torque [N m].
    """

    zeta: Reals
    sinkage: Reals
    forward: Reals
    torque: Reals

    def errors(self, test: WheelTest) -> tuple[float, float, float]:
        """Root mean square errors of sinkage [m], drawbar pull [N] and torque [N m]."""
        return (
            rms(self.sinkage - test.sinkage),
            rms(self.forward - test.forward),
            rms(self.torque - test.torque),
        )


def at_measured_sinkage(reading: Reading, test: WheelTest) -> Simulated:
    """Each row at its own measured sinkage, with the zeta that carries its load there."""
    setting = reading.setting(test)
    held = held_force(reading.simulator, setting, jnp.asarray(test.sinkage - reading.below_rim))
    zeta = held.zeta(setting.load)
    columns = map(np.asarray, (zeta, test.sinkage, held.forward(zeta), held.torque(zeta)))
    return Simulated(*columns)


def at_one_zeta(
    reading: Reading, test: WheelTest, zeta: float, speed: float = CARRIAGE_SPEED
) -> Simulated:
    """Every row at the height where its load is carried at this zeta."""
    setting = reading.setting(test, speed)
    rim = held_sinkage(reading.simulator, setting, jnp.asarray(zeta))
    every = jnp.full_like(rim, zeta)
    held = held_force(reading.simulator, setting, rim)
    columns = (every, rim + reading.below_rim, held.forward(every), held.torque(every))
    return Simulated(*map(np.asarray, columns))


def one_zeta(reading: Reading, test: WheelTest) -> Simulated:
    """The one zeta whose sinkages come closest to those of all rows, in least squares."""
    setting = reading.setting(test)
    # Stress is proportional to zeta: a load over some number and zeta over it sink alike, and the
    # search, made for numbers near one, is given those.
    scale = float(np.median(at_measured_sinkage(reading, test).zeta))
    setting = replace(setting, load=setting.load / scale)
    sinkage = jnp.asarray(test.sinkage - reading.below_rim)
    found = fit_zeta(reading.simulator, setting, sinkage, jnp.ones_like(sinkage))
    return at_one_zeta(reading, test, scale * float(found))


def height_decrease(test: WheelTest, speed: float = CARRIAGE_SPEED) -> Reals:
    """Height that the sand behind the wheel loses, r (r omega^2 / g) [m], shape (rows,)."""
    return (speed / (1 - test.slip)) ** 2 / GRAVITY


def arc_change(
    test: WheelTest,
    zeta: float,
    speed: float = CARRIAGE_SPEED,
    make: Callable[..., Reading] = true_wheel,
) -> Simulated:
    """What the arc's bisector adds to the vertical's, at the same zeta; differences in columns."""
    vertical = at_one_zeta(make(test), test, zeta, speed)
    arc = at_one_zeta(make(test, ArcBisector()), test, zeta, speed)
    return Simulated(
        vertical.zeta,
        arc.sinkage - vertical.sinkage,
        arc.forward - vertical.forward,
        arc.torque - vertical.torque,
    )


def arc_speed(
    test: WheelTest, zeta: float, change: float = 1e-3, halvings: int = 10
) -> tuple[float, int]:
    """Carriage speed at which the arc first moves a row's sinkage by so much, and that row.

    Args:
        test: Rows of a wheel.
        zeta: Scaling factor [-].
        change: Of sinkage [m].
        halvings: Of the logarithm of the speed, between 10 mm/s and 1 m/s.

    Returns:
        Carriage speed [m/s] and the number of the row.
    """
    low, high = np.log(CARRIAGE_SPEED), 0.0
    row = -1
    for _ in range(halvings):
        middle = (low + high) / 2
        moved = np.abs(arc_change(test, zeta, float(np.exp(middle))).sinkage)
        if moved.max() > change:
            high, row = middle, int(moved.argmax())
        else:
            low = middle
    return float(np.exp(high)), row
