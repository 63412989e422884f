"""Random mechanisms of the plant: every effect of the catalogue in a random form, and others.

A recipe draws the form of a mechanism (exponents, shapes, signs); its strength, one number, is
chosen afterwards.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from diagnose.blind.plant import bed, drive, force_sensors, machine, sand, sensors, unlisted
from diagnose.blind.plant.plant import Part, PlantChange
from diagnose.blind.plant.random_profiles import RandomCurve, draw_profile, draw_variation

UNKNOWN = "unknown"

Random = np.random.Generator


@dataclass(frozen=True)
class Mechanism:
    """Mechanism of a drawn form whose strength is still open.

    Attributes:
        name: The right answer: a name of the catalogue, or `UNKNOWN`.
        kind: The plant's own name of it.
        stage: Stage of the simulation in which it acts, or `UNKNOWN`.
        build: Builds the part of the plant from a strength.
        typical_strength: Strength to begin a search at, in the unit of the mechanism.
        max_strength: Greatest strength of a rig, in the same unit.
        form: Numbers and words of its form, for the labels.
    """

    name: str
    kind: str
    stage: str
    build: Callable[[float], Part]
    typical_strength: float
    max_strength: float
    form: dict[str, Any] = field(default_factory=dict)


# The fields `build`, `typical_strength`, `max_strength` and `form` of a mechanism.
RandomForm = tuple[Callable[[float], Part], float, float, dict[str, Any]]
Recipe = Callable[[Random], RandomForm]


def _sign(random: Random) -> float:
    return float(random.choice([-1.0, 1.0]))


def _log_uniform(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def make_part(kind: type, **numbers: Any) -> Part:
    """Effect of these numbers, which its fields convert to arrays."""
    return kind(**numbers)


def _effect(kind: type, quantity: str, typical: float, most: float, signed: bool = True, **shapes):
    """Recipe for an effect of one strength.

    Args:
        kind: Class of the effect.
        quantity: Its field that the strength goes into.
        typical, most: Typical and greatest strength.
        signed: Whether the sign of the strength is random, too.
        shapes: The draw of each other field.
    """

    def recipe(random: Random) -> RandomForm:
        sign = _sign(random) if signed else 1.0
        form = {name: float(draw(random)) for name, draw in shapes.items()}
        return (
            lambda strength: kind(**{quantity: sign * strength}, **form),
            typical,
            most,
            form | {"sign": sign},
        )

    return recipe


def _change(
    where: Callable[[Any], Any],
    typical: float,
    lowest: float,
    highest: float,
    size: str = "",
) -> Recipe:
    """Recipe for a change of a number of the simulator, between `lowest` and `highest`.

    Both are those of the default rig, and in proportion to the `size` named on others.
    """

    def recipe(random: Random) -> RandomForm:
        sign = _sign(random)
        most = highest if sign > 0 else -lowest
        return (
            lambda strength: PlantChange(where, sign * strength, size),
            typical,
            most,
            {"sign": sign},
        )

    return recipe


def _between(low: float, high: float) -> Callable[[Random], float]:
    return lambda random: random.uniform(low, high)


def _between_log(low: float, high: float) -> Callable[[Random], float]:
    return lambda random: _log_uniform(random, low, high)


def _loosening(random: Random) -> RandomForm:
    form = {
        "form": float(random.integers(3)),
        "decay": _log_uniform(random, 0.5, 6.0),
        "power": float(random.uniform(0.6, 1.6)),
    }
    return lambda strength: make_part(sand.PlantLoosening, loss=strength, **form), 0.1, 0.6, form


def _variation(random: Random) -> RandomForm:
    curve, values = draw_variation(random)
    sign = _sign(random)
    form = {"curve": curve, "sign": sign}
    table = RandomCurve(values)
    return (
        lambda strength: make_part(sand.PlantTerrainVariation, excess=sign * strength, curve=table),
        0.1,
        0.6,
        form,
    )


def _profile(random: Random) -> RandomForm:
    curve, values = draw_profile(random)
    sign = _sign(random)
    form = {"curve": curve, "sign": sign}
    table = RandomCurve(values)
    return (
        lambda strength: make_part(bed.PlantSurfaceProfile, amplitude=sign * strength, curve=table),
        0.001,
        0.008,
        form,
    )


def _excavation(random: Random) -> RandomForm:
    power = float(random.choice([random.uniform(-1, -0.3), random.uniform(0.3, 0.8)]))
    form = {"length": _log_uniform(random, 0.05, 0.5), "power": power}
    return lambda strength: make_part(bed.PlantExcavation, rate=strength, **form), 0.05, 0.5, form


def _gain(random: Random) -> RandomForm:
    sign, bend = _sign(random), float(random.uniform(0, 0.2))
    return (
        lambda strength: drive.PlantSpeedGain(sign * strength, bend),
        0.03,
        0.15,
        {"sign": sign, "bend": bend},
    )


def _lag(random: Random) -> RandomForm:
    damping = float(random.uniform(0.6, 1.3))
    return lambda strength: drive.PlantSpeedLag(strength, damping), 0.1, 0.6, {"damping": damping}


def _ripple(random: Random) -> RandomForm:
    order = _log_uniform(random, 2.0, 40.0)
    form = {
        "order": float(np.round(order)) if random.random() < 0.6 else order,
        "phase": float(random.uniform(0, 6.28)),
        "second": float(random.uniform(0.1, 0.5)),
        "second_phase": float(random.uniform(0, 6.28)),
    }
    return lambda strength: drive.PlantSpeedRipple(strength, **form), 0.03, 0.25, form


def _backlash(random: Random) -> RandomForm:
    snap = float(random.uniform(0.01, 0.04))
    return lambda strength: drive.PlantBacklash(strength, snap), 0.05, 0.4, {"snap": snap}


def _sensor(kind: type, typical: float, most: float, name: str, low: float, high: float) -> Recipe:
    def recipe(random: Random) -> RandomForm:
        sign, value = _sign(random), float(random.uniform(low, high))
        form = {"sign": sign, name: value}
        return lambda strength: kind(sign * strength, value), typical, most, form

    return recipe


def _delay(random: Random) -> RandomForm:
    return sensors.PlantMeasurementDelay, 0.1, 0.6, {}


def _channel_delay(random: Random) -> RandomForm:
    form = {"channel": str(random.choice(["x", "z"])), "drift": float(random.uniform(-0.1, 0.1))}
    return lambda strength: sensors.PlantChannelDelay(strength, **form), 0.1, 0.6, form


def _filter(random: Random) -> RandomForm:
    form = str(random.choice(["mean", "second order"]))
    return lambda strength: sensors.PlantMeasurementFilter(strength, form), 0.1, 0.6, {"form": form}


def _crosstalk(random: Random) -> RandomForm:
    sign = _sign(random)
    return lambda strength: sensors.DriveCrosstalk(sign * strength), 2e-4, 5e-3, {"sign": sign}


_phase = _between(0, 6.28)
_power = _between(0.8, 1.3)
_surplus = _between(0, 0.4)

# Recipes of the effects that an answer can name, by stage and name.
CATALOGUE: dict[str, dict[str, Recipe]] = {
    "terrain": {
        "loosening": _loosening,
        "slip_softening": _effect(
            sand.PlantSlipSoftening, "loss", 0.1, 0.6, False, power=_between(0.25, 0.9)
        ),
        "rate_hardening": _effect(
            bed.PlantRateHardening, "excess", 0.1, 0.8, False, power=_between(0.3, 1.0)
        ),
        "depth_hardening": _effect(bed.PlantDepthHardening, "power", 0.1, 0.5),
        "terrain_variation": _variation,
        "surface_profile": _profile,
        "surface_slope": _effect(
            bed.PlantSurfaceSlope, "slope", 0.005, 0.05, bend=_between(-0.15, 0.15)
        ),
        "rigid_floor": _effect(
            bed.PlantRigidFloor,
            "excess",
            0.1,
            5.0,
            False,
            floor=_between(0.028, 0.042),
            scale=_between(0.005, 0.015),
        ),
        "cohesion": _effect(
            bed.PlantCohesion, "depth", 0.001, 0.008, False, onset=_between(0.001, 0.005)
        ),
        "excavation": _excavation,
        "slip_sinkage": _effect(
            bed.PlantSlipSinkage, "rate", 0.1, 0.8, False, length=_between_log(0.06, 0.25)
        ),
        "heap": _effect(
            sand.PlantHeap,
            "force",
            3.0,
            40.0,
            False,
            power=_between(1.6, 2.4),
            braking=_between(0.5, 6.0),
            lift=_between(0.1, 0.5),
        ),
        "bulldozing": _effect(
            sand.PlantBulldozing, "force", 3.0, 30.0, False, length=_between_log(0.1, 0.8)
        ),
        "momentum_flux": _change(lambda s: s.terrain.law.inertial_coefficient, 0.8, -1.1, 2.5),
        "height_decrease": _change(lambda s: s.terrain.law.height_decrease, 0.8, -1.0, 2.0),
    },
    "wheel": {
        "wheel_radius": _change(lambda s: s.wheel.radius, 0.002, -0.012, 0.012, "radius"),
        "grouser_height": _change(
            lambda s: s.wheel.grouser_height, 0.002, -0.017, 0.006, "grouser_height"
        ),
        "grouser_shadowing": _effect(
            machine.PlantGrouserShadowing, "share", 0.2, 1.0, False, power=_between(1.5, 4.0)
        ),
        "eccentricity": _effect(
            machine.PlantEccentricity, "offset", 0.001, 0.006, False, phase=_phase
        ),
        "imbalance": _effect(
            machine.PlantImbalance, "moment_of_mass", 0.2, 2.0, False, phase=_phase
        ),
    },
    "rig": {
        "vertical_load": _effect(machine.PlantVerticalLoad, "force", 5.0, 40.0),
        "vertical_coulomb": _effect(
            machine.PlantVerticalCoulomb,
            "force",
            5.0,
            40.0,
            False,
            stick=_between_log(5e-5, 4e-4),
            surplus=_surplus,
        ),
        "vertical_viscous": _effect(
            machine.PlantVerticalViscous, "damping", 500.0, 10000.0, False, power=_power
        ),
        "horizontal_coulomb": _effect(
            machine.PlantHorizontalCoulomb,
            "force",
            3.0,
            25.0,
            False,
            stick=_between_log(5e-4, 4e-3),
            surplus=_surplus,
        ),
        "horizontal_viscous": _effect(
            machine.PlantHorizontalViscous, "damping", 20.0, 150.0, False, power=_power
        ),
        "drawbar": _effect(machine.PlantDrawbar, "force", 3.0, 25.0),
        "cable_spring": _effect(
            machine.PlantCableSpring, "stiffness", 4.0, 25.0, bend=_between(-0.2, 0.3)
        ),
        "vertical_spring": _effect(
            machine.PlantVerticalSpring, "stiffness", 300.0, 2500.0, False, bend=_between(-0.2, 0.4)
        ),
    },
    "drive": {
        "speed_gain": _gain,
        "speed_lag": _lag,
        "speed_ripple": _ripple,
        "backlash": _backlash,
    },
    "sensor": {
        "sinkage_gain": _sensor(sensors.PlantSinkageGain, 0.02, 0.15, "bend", -0.1, 0.1),
        "sinkage_drift": _sensor(sensors.PlantSinkageDrift, 2e-5, 3e-4, "power", 0.8, 1.25),
        "travel_gain": _sensor(sensors.PlantTravelGain, 0.01, 0.15, "bend", -0.1, 0.1),
        "measurement_delay": _delay,
        "measurement_filter": _filter,
        "channel_delay": _channel_delay,
    },
}


# Recipes of the effects that only a rig with a driven carriage and force sensors shows.
DRIVEN_CATALOGUE: dict[str, dict[str, Recipe]] = {
    "rig": {
        "vertical_compliance": _effect(
            force_sensors.PlantVerticalCompliance,
            "compliance",
            1e-5,
            3e-5,
            False,
            power=_between(0.7, 1.2),
        ),
    },
    "drive": {
        "carriage_gain": _effect(
            drive.PlantCarriageGain, "gain", 0.03, 0.15, bend=_between(-0.2, 0.2)
        ),
    },
    "sensor": {
        "force_offset": _effect(
            force_sensors.PlantForceOffset, "offset", 3.0, 30.0, False, direction=_phase
        ),
        "force_gain": _effect(
            force_sensors.PlantForceGain, "gain", 0.03, 0.2, fx_share=_between(0.5, 1.5)
        ),
        "force_crosstalk": _effect(force_sensors.PlantForceCrosstalk, "angle", 0.02, 0.15),
        "torque_offset": _effect(force_sensors.PlantTorqueOffset, "offset", 0.3, 3.0),
        "torque_friction": _effect(
            force_sensors.PlantTorqueFriction, "friction", 0.3, 3.0, False, share=_between(0.1, 0.5)
        ),
        "torque_gain": _effect(
            force_sensors.PlantTorqueGain, "gain", 0.03, 0.2, bend=_between(0.0, 0.3)
        ),
    },
}

# Effects that steady runs of a driven carriage do not show: they act on a free carriage, in ramps,
# or on clocks.
HIDDEN_IN_SWEEPS = frozenset(
    {
        "horizontal_coulomb",
        "horizontal_viscous",
        "drawbar",
        "cable_spring",
        "speed_lag",
        "backlash",
        "imbalance",
        "measurement_delay",
        "measurement_filter",
        "channel_delay",
    }
)

# Mechanisms that only a wheel with grousers has.
GROUSER_KINDS = frozenset({"grouser_height", "grouser_shadowing", "damaged_grouser"})


def effect_names(is_driven: bool = False) -> list[str]:
    """Names of the effects that runs with a free or a driven carriage show."""
    free = [name for names in CATALOGUE.values() for name in names]
    if not is_driven:
        return free
    driven = [name for names in DRIVEN_CATALOGUE.values() for name in names]
    return [name for name in free if name not in HIDDEN_IN_SWEEPS] + driven


# Recipes of the mechanisms that no answer can name, by the plant's own name.
UNLISTED: dict[str, Recipe] = {
    "damaged_grouser": _effect(
        unlisted.DamagedGrouser, "loss", 0.2, 0.8, phase=_phase, narrowness=_between(6, 30)
    ),
    "healing": _effect(
        unlisted.Healing,
        "loss",
        0.2,
        0.7,
        False,
        turning=_between(0.3, 2.0),
        recovery=_between(1.0, 5.0),
    ),
    "swing": _effect(
        unlisted.Swing, "excess", 0.05, 0.3, False, period=_between(5.0, 14.0), phase=_phase
    ),
    "thixotropy": _effect(
        unlisted.Thixotropy,
        "loss",
        0.2,
        0.7,
        False,
        length=_between_log(0.01, 0.1),
        recovery=_between(0.5, 3.0),
    ),
    "rise_and_fall": _effect(
        unlisted.RiseAndFall, "excess", 0.1, 0.6, speed=_between_log(1e-3, 5e-3)
    ),
    "critical_speed": _effect(
        unlisted.CriticalSpeed,
        "loss",
        0.2,
        0.7,
        omega=_between(0.4, 0.95),
        width=_between(0.1, 0.3),
    ),
    "catch": _effect(
        unlisted.Catch, "force", 5.0, 40.0, place=_between(0.1, 0.5), length=_between(0.05, 0.3)
    ),
    "sinkage_drag": _effect(unlisted.SinkageDrag, "drag", 20.0, 400.0, False),
    "jamming_guide": _effect(
        unlisted.JammingGuide, "friction", 200.0, 1500.0, False, stick=_between_log(1e-4, 5e-4)
    ),
    "travel_lift": _effect(unlisted.TravelLift, "lift", 100.0, 600.0),
    "drive_crosstalk": _crosstalk,
}


def stage_of(name: str) -> str:
    """Stage of the simulation in which an effect of either catalogue acts."""
    both = (*CATALOGUE.items(), *DRIVEN_CATALOGUE.items())
    return next(stage for stage, names in both if name in names)


def draw_mechanism(name: str, random: Random) -> Mechanism:
    """Draw the form of an effect of either catalogue."""
    stage = stage_of(name)
    recipes = CATALOGUE[stage] | DRIVEN_CATALOGUE.get(stage, {})
    return Mechanism(name, name, stage, *recipes[name](random))


def draw_unlisted(kind: str, random: Random) -> Mechanism:
    """Draw the form of a mechanism outside the catalogue."""
    return Mechanism(UNKNOWN, kind, UNKNOWN, *UNLISTED[kind](random))
