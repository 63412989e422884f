"""The plant: the simulator with a set's mechanisms in it, finer and in smaller steps than fits.

All runs of all sets whose mechanisms are of the same groups share one compiled program: a group's
mechanisms are all in it, those that were not drawn with a strength of zero.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diagnose.blind.plant.bed import GROUND, STRESS
from diagnose.blind.plant.drive import GRID, AbstractPlantDrive
from diagnose.blind.plant.machine import RIG, WHEEL
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sand import SAND
from diagnose.blind.plant.sensors import AbstractPlantSensor, PlantReading
from diagnose.blind.plant.unlisted import STRANGERS
from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.effects import composition as chain
from drftjax.effects.base import AbstractEffect, StepContext
from drftjax.physics.command import Command
from drftjax.physics.integrator import HeldPace
from drftjax.physics.rig import Rig
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.trial import Trial

PLATE_SIZE = 0.0025


ROW = 0.01


EVERY = 10


# Room for every run: points of the wheel's course, and rows of the shortest steps.
LONGEST = 24.0


POINTS = round(LONGEST / GRID) + 1


ROWS = 12000


# The rail, and what of it lies on the side that no run goes to [m].
RAIL, SPARE = 5.5, 0.25


# A wheel let down a while ago still creeps by so much [m/s].
CREEP = 1.3e-4


# Sinkages that a standing wheel is looked for at [m].
SINKAGES = np.linspace(0.002, 0.042, 161)


GROUPS: dict[str, tuple[type[AbstractEffect], ...]] = {
    "wheel": WHEEL,
    "sand": SAND,
    # A power of every plate's depth or speed is dear, so each has a program of its own.
    **{f"stress {kind.__name__}": (kind,) for kind in STRESS},
    "ground": GROUND,
    "rig": RIG,
    "stranger": STRANGERS,
}


@dataclass(frozen=True)
class PlantChange:
    """A mechanism that is but another number of the simulator's own.

    Attributes:
        where: Which number.
        by: What is added to it.
    """

    where: Callable[[Simulator], Array]
    by: float


Part = AbstractEffect | PlantChange | AbstractPlantDrive | AbstractPlantSensor


def group_of(part: Part) -> str | None:
    """Which group of effects a part belongs to; none where it needs no program of its own."""
    return next((name for name, classes in GROUPS.items() if type(part) in classes), None)


def groups_of(parts: Sequence[Part]) -> tuple[str, ...]:
    """The groups that parts belong to, in the order that they act in."""
    wanted = {group_of(part) for part in parts}
    return tuple(name for name in GROUPS if name in wanted)


@cache
def _absent(kind: type[AbstractEffect]) -> AbstractEffect:
    return kind()


@cache
def nominal_wheel() -> GrouserWheel:
    return GrouserWheel(plate_size=PLATE_SIZE)


def make_plant(
    parts: Sequence[Part], groups: Sequence[str], zeta: float, mass_z: float
) -> Simulator:
    """The simulator with these parts in it; groups without a part are there at strength zero."""
    given = {type(part): part for part in parts if isinstance(part, AbstractEffect)}
    effects = tuple(given.get(kind, _absent(kind)) for name in groups for kind in GROUPS[name])
    terrain = Terrain(ConstantZeta(zeta))
    simulator = Simulator(nominal_wheel(), terrain, Rig(mass_z=mass_z), HeldPace(), effects)
    for part in parts:
        if isinstance(part, PlantChange):
            simulator = eqx.tree_at(part.where, simulator, part.where(simulator) + part.by)
    return simulator


@eqx.filter_jit
def _missing(simulator: Simulator, sinkages: Float[Array, " all"]) -> Float[Array, " all"]:
    """What the sand bears less than it must of a wheel pushed down to these sinkages [N]."""
    simulator = simulator.prepared()
    nought = jnp.zeros(())
    command = Command(nought, nought, nought)

    def at(sinkage: Float[Array, ""]) -> Float[Array, ""]:
        state = simulator.begin(State.at_rest(sinkage), command)
        down = jnp.stack([nought, nought - CREEP])
        still = jnp.zeros(2)
        place, memory = state.position, state.memory
        moment = StepContext(
            nought, nought + 1e-9, place, still, nought, nought, nought, simulator.wheel.radius
        )
        zeta = simulator.terrain.zeta(nought, command)
        zeta = zeta * chain.zeta_factor(simulator.effects, memory, moment)
        sand = simulator.wrench(place, down, nought, nought, zeta, None, memory)
        held = [
            chain.loads(simulator.effects, memory, place, still, moment, of_the_sand=each)
            for each in (True, False)
        ]
        return simulator.rig.mass_z * simulator.rig.gravity - sand[1] - held[0][1] - held[1][1]

    return jax.lax.map(at, sinkages)


def standing_start(simulator: Simulator) -> float:
    """Sinkage at which the plant's own wheel stands once let down [m].

    Raises:
        InputError: where it stands at none.
    """
    missing = np.asarray(_missing(simulator, as_real(SINKAGES)))
    borne = np.flatnonzero(missing < 0)
    if not len(borne) or borne[0] == 0:
        raise InputError("the plant's wheel stands at no sinkage within reach")
    last = borne[0]
    share = missing[last - 1] / (missing[last - 1] - missing[last])
    return float(SINKAGES[last - 1] + share * (SINKAGES[last] - SINKAGES[last - 1]))


def _rail(course: np.ndarray) -> tuple[float, float]:
    """How far back and ahead of its start the rail goes [m]: far, where the wheel is to go."""
    return (-RAIL if course.min() < 0 else -SPARE), (RAIL if course.max() > 0 else SPARE)


@eqx.filter_jit
def _rows(trial: Trial, rows: Int[Array, ""]) -> Float[Array, "2 rows"]:
    return trial.run_to(rows, ("x", "z"))


def run_plant(
    parts: Sequence[Part],
    profile: PlannedRun,
    zeta: float,
    groups: Sequence[str] | None = None,
    finer: float = 2.0,
) -> PlantReading:
    """One run of the plant, free of noise, in rows of 10 ms.

    Args:
        parts: What is wrong with it.
        profile: What it is asked.
        zeta: Scaling factor [-].
        groups: Groups that its program holds; those of `parts` where none are given.
        finer: How many times shorter its step is than a fit's.

    Raises:
        InputError: where the wheel digs in, takes off or leaves what the model covers.
    """
    simulator = make_plant(
        parts, groups_of(parts) if groups is None else groups, zeta, profile.mass
    )
    course_time = np.arange(POINTS) * GRID
    course = profile.omega(course_time)
    for part in parts:
        if isinstance(part, AbstractPlantDrive):
            course = part.follow(course)
    step = profile.steady_step() / finer
    sinkage = standing_start(simulator)
    knots = as_real(course_time), as_real(course), as_real(np.zeros(POINTS))
    start = State.at_rest(sinkage)
    trial = Trial(simulator, start, *knots, as_real(step), EVERY, ROWS)
    number = round(profile.duration / (EVERY * step))
    if number > ROWS or profile.duration > LONGEST + 1e-9:
        raise InputError(f"a run of {profile.duration:g} s at {step:g} s a step is too long")
    x, z = np.asarray(_rows(trial, jnp.asarray(number)))[:, : number + 1]
    deepest = float(simulator.wheel.cut().sinkage_limit)
    if not (np.isfinite(x).all() and np.isfinite(z).all()) or -z.min() > deepest:
        raise InputError("the plant's wheel digs in")
    back, ahead = _rail(course)
    if x.max() > ahead or x.min() < back:
        raise InputError("the plant's wheel leaves its rail")
    time = np.arange(number + 1) * EVERY * step
    reading = PlantReading(time, x, z, np.interp(time, course_time, course))
    for part in parts:
        if isinstance(part, AbstractPlantSensor):
            reading = part.read(reading)
    return reading.at(np.arange(round(profile.duration / ROW) + 1) * ROW)
