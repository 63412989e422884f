"""The plant: the simulator with the mechanisms of a set, in finer plates and steps than a fit's.

All runs of all sets whose mechanisms belong to the same groups share one compiled program: it holds
all mechanisms of a group, those that were not drawn at strength zero.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diagnose.blind.plant.bed import STRESS_EFFECTS, SURFACE_EFFECTS
from diagnose.blind.plant.drive import SPEED_INTERVAL, AbstractPlantDrive, PlantCarriageGain
from diagnose.blind.plant.machine import RIG_EFFECTS, SHADOW_EFFECTS, WHEEL_EFFECTS
from diagnose.blind.plant.rig import DEFAULT_RIG, GRAVITY, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sand import SAND_EFFECTS
from diagnose.blind.plant.sensors import AbstractPlantSensor, PlantReading
from diagnose.blind.plant.unlisted import UNLISTED_EFFECTS
from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.effects import composition
from drftjax.effects.base import AbstractEffect, StepContext
from drftjax.physics.command import Command
from drftjax.physics.implicit import NewtonSettings
from drftjax.physics.integrator import ImplicitEuler
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, Terrain
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import standing_sinkage
from drftjax.simulation.step_choice import choose_step
from drftjax.simulation.trial import Trial


@dataclass(frozen=True)
class PlantSettings:
    """Resolution and limits of the plant.

    Attributes:
        plate_size: Length of a plate of the default wheel [m]; finer than a fit's, and in
            proportion on other wheels.
        step_refinement: Ratio of a fit's time step to the plant's [-].
        row_interval: Interval of the rows of a reading [s].
        standing: Width at rest of a wheel that does not turn, over sqrt(r g) [-]; a hundredth of
            the model's, so that a wheel that stands moves by 2 um in 24 s at most.
        tolerance: Change of velocity at which a step is found, over sqrt(r g) [-]: well below the
            width, or the forces on a wheel that stands would not balance; below a thousandth of it
            the search chatters where plates begin to lead.
        longest_run: Longest run that the program has room for [s].
        max_steps: Most steps that it has room for, which the shortest steps need.
        rail_length: Length of the rail from the start to where the wheel is to go [m].
        rail_spare: Length of the rail on the side to which no run goes [m].
        creep_ratio: Speed of a wheel that was let down, over its width at rest [-]: it stands half
            a per cent deeper than the depth that just carries it, and so stays there.
        static_sinkages: Least and greatest sinkage, over the radius [-], at which the static one
            is looked for, and the number of sinkages tried.
    """

    plate_size: float = 0.0025
    step_refinement: float = 2.0
    row_interval: float = 0.01
    standing: float = 5e-9
    tolerance: float = 1e-10
    longest_run: float = 24.0
    max_steps: int = 76800
    rail_length: float = 5.5
    rail_spare: float = 0.25
    creep_ratio: float = 10.0
    static_sinkages: tuple[float, float, int] = (0.013, 0.33, 161)


DEFAULT_PLANT = PlantSettings()


GROUPS: dict[str, tuple[type[AbstractEffect], ...]] = {
    "wheel": WHEEL_EFFECTS,
    "sand": SAND_EFFECTS,
    # A power for every plate is expensive, so each of these has a program of its own.
    "shadow": SHADOW_EFFECTS,
    **{f"stress {kind.__name__}": (kind,) for kind in STRESS_EFFECTS},
    "surface": SURFACE_EFFECTS,
    "rig": RIG_EFFECTS,
    "unlisted": UNLISTED_EFFECTS,
}


# Groups that one program holds for sets of many mechanisms: to compile another takes longer than
# what they cost.
COMMON_GROUPS = ("wheel", "sand", "surface", "rig")


@dataclass(frozen=True)
class PlantChange:
    """Mechanism that changes a number of the simulator itself.

    Attributes:
        where: Selects that number.
        by: Added to it, in its unit.
        size: Name of the size of a `PlantRig` that it is in proportion to; none if empty.
    """

    where: Callable[[Simulator], Array]
    by: float
    size: str = ""


Part = AbstractEffect | PlantChange | AbstractPlantDrive | PlantCarriageGain | AbstractPlantSensor


def group_of(part: Part) -> str | None:
    """Name of the group of effects that a part belongs to; None if it needs no program."""
    return next((name for name, classes in GROUPS.items() if type(part) in classes), None)


def groups_of(parts: Sequence[Part], held: Collection[str] = ()) -> tuple[str, ...]:
    """Names of the groups that parts belong to, and of those held anyway, as in `GROUPS`."""
    wanted = {*held, *(group_of(part) for part in parts)}
    return tuple(name for name in GROUPS if name in wanted)


@cache
def _absent(kind: type[AbstractEffect]) -> AbstractEffect:
    return kind()


def make_plant(
    parts: Sequence[Part],
    groups: Sequence[str],
    zeta: float,
    mass_z: float,
    settings: PlantSettings = DEFAULT_PLANT,
    rig: PlantRig = DEFAULT_RIG,
) -> Simulator:
    """Build the simulator with these mechanisms.

    Args:
        parts: Mechanisms of the plant.
        groups: Groups of effects that it holds; those without a part are at strength zero.
        zeta: Scaling factor [-].
        mass_z: Vertical mass [kg].
        settings: Resolution of the plant.
        rig: Wheel, masses, carriage and sand.
    """
    given = {type(part): part for part in parts if isinstance(part, AbstractEffect)}
    effects = tuple(given.get(kind, _absent(kind)) for name in groups for kind in GROUPS[name])
    simulator = Simulator(
        rig.wheel(settings.plate_size),
        Terrain(ConstantZeta(zeta)),
        rig.frame(mass_z),
        ImplicitEuler(NewtonSettings(settings.tolerance), settings.standing),
        effects,
    )
    simulator = eqx.tree_at(
        lambda s: s.terrain.law.coefficients.values, simulator, replace_fn=rig.coefficients
    )
    for part in parts:
        if isinstance(part, PlantChange):
            simulator = eqx.tree_at(part.where, simulator, part.where(simulator) + part.by)
    return simulator


@eqx.filter_jit
def _missing_force(
    simulator: Simulator, sinkages: Float[Array, " all"], creep_speed: Float[Array, ""]
) -> Float[Array, " all"]:
    """Vertical force that a wheel at rest lacks for equilibrium at these sinkages [N]."""
    simulator = simulator.prepared()
    zero = jnp.zeros(())
    command = Command(zero, zero, zero)

    def at(sinkage: Float[Array, ""]) -> Float[Array, ""]:
        state = simulator.begin(State.at_rest(sinkage), command)
        down = jnp.stack([zero, zero - creep_speed])
        still = jnp.zeros(2)
        position, memory = state.position, state.memory
        moment = StepContext(
            zero, zero + 1e-9, position, still, zero, zero, zero, simulator.wheel.radius
        )
        zeta = simulator.terrain.zeta(zero, command)
        zeta = zeta * composition.zeta_factor(simulator.effects, memory, moment)
        sand = simulator.wrench(position, down, zero, zero, zeta, memory)
        loads = [
            composition.loads(simulator.effects, memory, position, still, moment, of_the_sand=each)
            for each in (True, False)
        ]
        return simulator.rig.mass_z * simulator.rig.gravity - sand[1] - loads[0][1] - loads[1][1]

    return jax.lax.map(at, sinkages)


def _missing_at(simulator: Simulator, sinkages: np.ndarray, settings: PlantSettings) -> np.ndarray:
    width = settings.standing * math.sqrt(float(simulator.wheel.radius) * GRAVITY)
    creep = as_real(settings.creep_ratio * width)
    return np.asarray(_missing_force(simulator, as_real(sinkages), creep))


def missing_force_at(
    sinkage: float, zeta: float, rig: PlantRig, settings: PlantSettings = DEFAULT_PLANT
) -> float:
    """Vertical force [N] that a rig's wheel lacks to stand at a sinkage, without a mechanism.

    Args:
        sinkage: Sinkage [m].
        zeta: Scaling factor [-].
        rig: Wheel, standard load and sand.
        settings: Resolution of the plant.
    """
    simulator = make_plant((), (), zeta, rig.mass_z, settings, rig)
    sinkages = np.full(settings.static_sinkages[2], sinkage)
    return float(_missing_at(simulator, sinkages, settings)[0])


def standing_start(simulator: Simulator, settings: PlantSettings = DEFAULT_PLANT) -> float:
    """Sinkage of the plant's own wheel at rest [m].

    Raises:
        InputError: No sinkage within reach is an equilibrium.
    """
    sinkages = float(simulator.wheel.radius) * np.linspace(*settings.static_sinkages)
    missing = _missing_at(simulator, sinkages, settings)
    carrying = np.flatnonzero(missing < 0)
    if not len(carrying) or carrying[0] == 0:
        raise InputError("the plant's wheel stands at no sinkage within reach")
    last = carrying[0]
    share = missing[last - 1] / (missing[last - 1] - missing[last])
    return float(sinkages[last - 1] + share * (sinkages[last] - sinkages[last - 1]))


@eqx.filter_jit
def _stored_rows(trial: Trial, rows: Int[Array, ""]) -> Float[Array, "5 rows"]:
    return trial.extrapolated(rows, ("x", "z", "fx", "fz", "torque"))


# Length of a plate of a fit's wheel [m].
FIT_PLATE_SIZE = 0.004


def fit_step(planned: PlannedRun, zeta: float, rig: PlantRig = DEFAULT_RIG) -> float:
    """Step that a fit to this run would choose [s], by the wheel without a mechanism.

    The step is that on sand up to twice as stiff, so that few different ones are searched for.

    Args:
        planned: Commanded speed and load.
        zeta: Scaling factor [-].
        rig: Wheel, masses, carriage and sand.

    Raises:
        InputError: The sand does not carry the wheel.
    """
    return _fit_step(planned, 2.0 ** math.ceil(math.log2(zeta)), rig)


@cache
def _fit_step(planned: PlannedRun, zeta: float, rig: PlantRig) -> float:
    simulator = Simulator(
        rig.wheel(FIT_PLATE_SIZE), Terrain(ConstantZeta(zeta)), rig.frame(planned.mass)
    )
    time, speed = as_real(planned.time), as_real(np.radians(planned.speed))
    start = State.at_rest(standing_sinkage(simulator, zeta))
    carriage = as_real(planned.carriage or np.zeros(len(planned.time)))
    trial = Trial(simulator, start, time, speed, carriage, as_real(0.0), 1, 1)
    return choose_step(trial).step


def run_plant(
    parts: Sequence[Part],
    planned: PlannedRun,
    zeta: float,
    groups: Sequence[str] | None = None,
    settings: PlantSettings = DEFAULT_PLANT,
    rig: PlantRig = DEFAULT_RIG,
    sinkage: float | None = None,
) -> PlantReading:
    """Simulate one run of the plant, free of noise.

    Args:
        parts: Mechanisms of the plant.
        planned: Commanded speed and load.
        zeta: Scaling factor [-].
        groups: Groups of effects that its program holds; those of `parts` if None.
        settings: Resolution and limits of the plant.
        rig: Wheel, masses, carriage and sand.
        sinkage: Sinkage at the start [m]; that of a wheel that was let down if None.

    Returns:
        Reading every `settings.row_interval`, from the start of the run.

    Raises:
        InputError: The wheel digs in, takes off or leaves its rail or the range of the model.
    """
    groups = groups_of(parts) if groups is None else groups
    simulator = make_plant(parts, groups, zeta, planned.mass, settings, rig)
    points = round(settings.longest_run / SPEED_INTERVAL) + 1
    speed_time = np.arange(points) * SPEED_INTERVAL
    speed, carriage = planned.omega(speed_time), planned.carriage_speed(speed_time)
    for part in parts:
        if isinstance(part, AbstractPlantDrive):
            speed = part.follow(speed)
        elif isinstance(part, PlantCarriageGain):
            carriage = part.follow(carriage)
    step = fit_step(planned, zeta, rig) / settings.step_refinement
    start = State.at_rest(standing_start(simulator, settings) if sinkage is None else sinkage)
    knots = as_real(speed_time), as_real(speed), as_real(carriage)
    trial = Trial(simulator, start, *knots, as_real(step), 1, settings.max_steps)
    number = math.ceil(planned.duration / step - 1e-9)
    if number > settings.max_steps or planned.duration > settings.longest_run + 1e-9:
        raise InputError(f"a run of {planned.duration:g} s at {step:g} s a step is too long")
    stored = np.asarray(_stored_rows(trial, jnp.asarray(number)))[:, : number + 1]
    x, z, fx, fz, torque = stored
    _require_on_the_rig(simulator, speed, x, z, settings)
    time = np.arange(number + 1) * step
    reading = PlantReading(time, x, z, np.interp(time, speed_time, speed), fx, fz, torque)
    for part in parts:
        if isinstance(part, AbstractPlantSensor):
            reading = part.read(reading)
    rows = round(planned.duration / settings.row_interval) + 1
    return reading.at(np.arange(rows) * settings.row_interval)


def _require_on_the_rig(
    simulator: Simulator, speed: np.ndarray, x: np.ndarray, z: np.ndarray, settings: PlantSettings
) -> None:
    deepest = float(simulator.wheel.cut().sinkage_limit)
    if not (np.isfinite(x).all() and np.isfinite(z).all()) or -z.min() > deepest:
        raise InputError("the plant's wheel digs in")
    back = settings.rail_length if speed.min() < 0 else settings.rail_spare
    ahead = settings.rail_length if speed.max() > 0 else settings.rail_spare
    if x.max() > ahead or x.min() < -back:
        raise InputError("the plant's wheel leaves its rail")
