"""Random rigs of the plant, and mechanisms in proportion to them."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnose.blind.generation.random_mechanisms import Mechanism
from diagnose.blind.generation.recording import Logger
from diagnose.blind.generation.settings import GenerationSettings, RigSettings
from diagnose.blind.plant import bed, drive, force_sensors, machine, sand, sensors, unlisted
from diagnose.blind.plant.plant import Part, PlantChange, PlantSettings, missing_force_at
from diagnose.blind.plant.rig import DEFAULT_RIG, GRAVITY, PlantRig
from drftjax.common.errors import InputError

# Powers of length and of force that a number of a part is in proportion to, by class; the first
# number of each is its strength. Times do not change from rig to rig, so speeds go with lengths.
# Numbers that are not named are ratios, angles or times.
NONE, LENGTH, FORCE = (0, 0), (1, 0), (0, 1)
STIFFNESS = DAMPING = (-1, 1)
Dimensions = tuple[int, int]
SCALES: dict[type, dict[str, Dimensions]] = {
    sand.PlantLoosening: {"loss": NONE},
    sand.PlantSlipSoftening: {"loss": NONE},
    sand.PlantTerrainVariation: {"excess": NONE},
    sand.PlantBulldozing: {"force": FORCE, "length": LENGTH},
    sand.PlantHeap: {"force": FORCE, "sinkage": LENGTH},
    bed.PlantRateHardening: {"excess": NONE},
    bed.PlantDepthHardening: {"power": NONE, "reference": LENGTH},
    bed.PlantRigidFloor: {"excess": NONE, "floor": LENGTH, "scale": LENGTH},
    bed.PlantCohesion: {"depth": LENGTH, "onset": LENGTH},
    bed.PlantSurfaceProfile: {"amplitude": LENGTH},
    bed.PlantSurfaceSlope: {"slope": NONE, "bend": (-1, 0)},
    bed.PlantExcavation: {"rate": NONE, "length": LENGTH},
    bed.PlantSlipSinkage: {"rate": NONE, "length": LENGTH},
    machine.PlantVerticalLoad: {"force": FORCE},
    machine.PlantVerticalCoulomb: {"force": FORCE, "stick": LENGTH},
    machine.PlantVerticalViscous: {"damping": DAMPING},
    machine.PlantHorizontalCoulomb: {"force": FORCE, "stick": LENGTH},
    machine.PlantHorizontalViscous: {"damping": DAMPING},
    machine.PlantDrawbar: {"force": FORCE},
    machine.PlantCableSpring: {"stiffness": STIFFNESS, "bend": (-1, 0)},
    machine.PlantVerticalSpring: {"stiffness": STIFFNESS},
    machine.PlantImbalance: {"moment_of_mass": FORCE},
    machine.PlantEccentricity: {"offset": LENGTH},
    machine.PlantGrouserShadowing: {"share": NONE},
    drive.PlantSpeedGain: {"gain": NONE},
    drive.PlantSpeedLag: {"lag": NONE},
    drive.PlantSpeedRipple: {"amplitude": NONE},
    drive.PlantBacklash: {"play": NONE},
    drive.PlantCarriageGain: {"gain": NONE},
    sensors.PlantSinkageGain: {"gain": NONE},
    sensors.PlantSinkageDrift: {"rate": LENGTH},
    sensors.PlantTravelGain: {"gain": NONE, "bend": (-1, 0)},
    sensors.PlantMeasurementDelay: {"delay": NONE},
    sensors.PlantMeasurementFilter: {"lag": NONE},
    sensors.PlantChannelDelay: {"delay": NONE},
    sensors.DriveCrosstalk: {"offset": LENGTH},
    force_sensors.PlantVerticalCompliance: {"compliance": (1, -1), "force": FORCE},
    force_sensors.PlantForceOffset: {"offset": FORCE},
    force_sensors.PlantForceGain: {"gain": NONE},
    force_sensors.PlantForceCrosstalk: {"angle": NONE},
    force_sensors.PlantTorqueOffset: {"offset": (1, 1)},
    force_sensors.PlantTorqueFriction: {"friction": (1, 1), "force": FORCE},
    force_sensors.PlantTorqueGain: {"gain": NONE, "torque": (1, 1)},
    unlisted.DamagedGrouser: {"loss": NONE},
    unlisted.Healing: {"loss": NONE},
    unlisted.Swing: {"excess": NONE},
    unlisted.Thixotropy: {"loss": NONE, "length": LENGTH},
    unlisted.RiseAndFall: {"excess": NONE, "speed": LENGTH},
    unlisted.CriticalSpeed: {"loss": NONE},
    unlisted.Catch: {"force": FORCE},
    unlisted.SinkageDrag: {"drag": (-2, 1)},
    unlisted.JammingGuide: {"friction": DAMPING, "stick": LENGTH},
    unlisted.TravelLift: {"lift": DAMPING},
}


def strength_of(part: Part) -> float:
    """Strength of a part in its own unit, with its sign."""
    if isinstance(part, PlantChange):
        return float(part.by)
    return float(getattr(part, next(iter(SCALES[type(part)]))))


def part_for(part: Part, rig: PlantRig) -> Part:
    """A part of the default rig in proportion to another one."""
    length, force = rig.length_scale, rig.force_scale
    if isinstance(part, PlantChange):
        ratio = getattr(rig, part.size) / getattr(DEFAULT_RIG, part.size) if part.size else 1.0
        return dataclasses.replace(part, by=part.by * ratio)
    factors = {
        name: length**power * force**other for name, (power, other) in SCALES[type(part)].items()
    }
    numbers = {name: getattr(part, name) * factor for name, factor in factors.items()}
    if isinstance(part, machine.PlantGrouserShadowing):
        numbers |= {"radius": rig.radius, "height": rig.grouser_height}
    dataclass_part: Any = part
    return dataclasses.replace(dataclass_part, **numbers)


def mechanism_for(mechanism: Mechanism, rig: PlantRig) -> Mechanism:
    """A mechanism whose parts are in proportion to a rig, at the same strengths."""
    return dataclasses.replace(
        mechanism, build=lambda strength: part_for(mechanism.build(strength), rig)
    )


@dataclass(frozen=True)
class DrawnRig:
    """Rig of a set, with its sand and its logger.

    Attributes:
        rig: Wheel, masses and carriage.
        zeta: Scaling factor of its sand [-].
        interval: Time between the logger's rows [s].
    """

    rig: PlantRig
    zeta: float
    interval: float

    def logger(self, settings: GenerationSettings) -> Logger:
        """Recorder of its runs."""
        return Logger(self.rig, self.interval, settings)

    def resolution(self, settings: GenerationSettings) -> PlantSettings:
        """Resolution of the plant, with the logger's rows."""
        return dataclasses.replace(settings.plant, row_interval=self.interval)

    def document(self) -> dict:
        """The rig as a label holds it."""
        rig = dataclasses.asdict(self.rig)
        rig["stress_factors"] = list(self.rig.stress_factors)
        return {"zeta": self.zeta, "rig": {**rig, "sampling_hz": 1 / self.interval}}


def draw_rig(
    random: np.random.Generator,
    settings: GenerationSettings,
    needs_grousers: bool = False,
    is_driven: bool = False,
) -> DrawnRig:
    """Draw the default rig, or one of another size, with sand that carries it.

    Args:
        random: Source of every choice.
        settings: Distribution of the rigs.
        needs_grousers: Whether a smooth wheel is no choice.
        is_driven: Whether the carriage is driven.

    Raises:
        InputError: No rig of the wanted masses stands as deep as it should on any sand.
    """
    zeta = float(random.uniform(*settings.zeta))
    rigs = settings.rigs
    if random.random() >= rigs.share:
        rig = dataclasses.replace(DEFAULT_RIG, is_driven=is_driven)
        return DrawnRig(rig, zeta, settings.plant.row_interval)
    interval = 1 / float(random.choice(rigs.sampling))
    for _ in range(rigs.draws):
        rig = _other_rig(random, rigs, needs_grousers, is_driven)
        sinkage = float(random.uniform(*rigs.sinkage)) * rig.radius
        carried = rig.mass_z * GRAVITY - missing_force_at(sinkage, 1.0, rig, settings.plant)
        zeta = rig.mass_z * GRAVITY / carried
        if rigs.zeta[0] <= zeta <= rigs.zeta[1]:
            return DrawnRig(rig, zeta, interval)
    raise InputError("no rig stands as deep as it should on any sand")


def _other_rig(
    random: np.random.Generator, rigs: RigSettings, needs_grousers: bool, is_driven: bool
) -> PlantRig:
    radius, mass = (
        float(np.exp(random.uniform(*np.log(bounds)))) for bounds in (rigs.radius, rigs.mass)
    )
    width, mass_x, height, thickness = (
        float(random.uniform(*bounds))
        for bounds in (rigs.width, rigs.mass_x, rigs.grouser_height, rigs.grouser_thickness)
    )
    count = int(random.choice(rigs.grouser_counts))
    smooth = random.random() < rigs.smooth_share and not needs_grousers
    return PlantRig(
        radius=round(radius, 4),
        width=round(width * radius, 4),
        grouser_count=0 if smooth else count,
        grouser_height=round(height * radius, 5),
        grouser_thickness=round(thickness * radius, 5),
        mass_x=round(mass_x * mass, 3),
        mass_z=round(mass, 3),
        is_driven=is_driven,
    )
