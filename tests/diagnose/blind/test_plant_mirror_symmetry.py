"""The plant of blind sets with a wheel that turns backward: each mechanism in the mirror.

As in `tests/drftjax/effects/test_mirror_symmetry.py`, a mechanism without a direction mirrors by
itself, and one that is fixed in space or to the wheel does once it is mirrored as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diagnose.blind.generation.random_mechanisms import CATALOGUE, UNLISTED
from diagnose.blind.plant import bed, drive, machine, sand, sensors, unlisted
from diagnose.blind.plant.plant import Part, PlantChange, PlantSettings, run_plant
from diagnose.blind.plant.random_profiles import PLACES, RandomCurve, draw_variation
from diagnose.blind.plant.run_plan import PlannedRun
from diagnose.blind.plant.sensors import PlantReading
from drftjax.effects.base import StepContext

# Every run starts with a grouser straight under the axle, at the very corner of the leading-plate
# rule: a rounding decides which of its faces leads at first [m].
CORNER = 5e-6
# What a mechanism fixed in space does on the wrong side is far more [m].
SEEN = 5e-5
# Places that the way back is told by: play is crossed to a place, and begins at one.
BETWEEN = 2 * drive.SPEED_INTERVAL
# A catch slips off at 0.2 m, of which places 1.5 mm apart miss up to one.
SLIPS = 0.01
MASS, ZETA = 18.837, 0.8
# Steps twice as long as a fit's, so that tests are quick.
COARSE = PlantSettings(step_refinement=0.5)


def profile(time: Sequence[float], speed: Sequence[float]) -> PlannedRun:
    """A commanded speed by its knots [s], [rad/s]."""
    return PlannedRun(tuple(time), tuple(np.degrees(speed).tolist()), MASS)


def mirrored(one: PlannedRun) -> PlannedRun:
    return replace(one, speed=tuple(-each for each in one.speed))


FORWARD = profile((0.0, 0.2, 0.9, 2.2, 2.6), (0.0, 0.0, 1.75, 1.75, 0.0))
BACKWARD = mirrored(FORWARD)
REVERSED = profile((0.0, 0.2, 0.6, 1.2, 2.0, 2.8, 3.2), (0.0, 0.0, 1.0, 1.0, -1.0, -1.0, 0.0))

WAVY = RandomCurve(np.sin(15 * PLACES + 0.4) - np.sin(0.4))
MIRRORED = RandomCurve(np.interp(-PLACES, PLACES, np.asarray(WAVY.values)))


def law(name: str, by: float) -> Part:
    return PlantChange(lambda s: getattr(s.terrain.law, name), by)


def wheel(name: str, by: float) -> Part:
    return PlantChange(lambda s: getattr(s.wheel, name), by)


# By kind: what is wrong, and what is wrong in the mirror where that is something else.
PARTS: dict[str, tuple[Part, ...]] = {
    "loosening": (sand.PlantLoosening(0.3, 1.0),),
    "slip_softening": (sand.PlantSlipSoftening(0.3),),
    "rate_hardening": (bed.PlantRateHardening(0.2),),
    "depth_hardening": (bed.PlantDepthHardening(0.2),),
    "terrain_variation": (
        sand.PlantTerrainVariation(0.2, WAVY),
        sand.PlantTerrainVariation(0.2, MIRRORED),
    ),
    "surface_profile": (
        bed.PlantSurfaceProfile(0.003, WAVY),
        bed.PlantSurfaceProfile(0.003, MIRRORED),
    ),
    "surface_slope": (bed.PlantSurfaceSlope(0.02, 0.1), bed.PlantSurfaceSlope(-0.02, -0.1)),
    "rigid_floor": (bed.PlantRigidFloor(0.5, 0.03),),
    "cohesion": (bed.PlantCohesion(0.003),),
    "excavation": (bed.PlantExcavation(0.2),),
    "slip_sinkage": (bed.PlantSlipSinkage(0.2),),
    "heap": (sand.PlantHeap(10.0),),
    "bulldozing": (sand.PlantBulldozing(15.0, 0.2),),
    "momentum_flux": (law("inertial_coefficient", 2.0),),
    "height_decrease": (law("height_decrease", 2.0),),
    "wheel_radius": (wheel("radius", 0.004),),
    "grouser_height": (wheel("grouser_height", -0.004),),
    "grouser_shadowing": (machine.PlantGrouserShadowing(0.3),),
    "eccentricity": (
        machine.PlantEccentricity(0.002, 0.5),
        machine.PlantEccentricity(0.002, np.pi - 0.5),
    ),
    "imbalance": (machine.PlantImbalance(2.0, 0.5), machine.PlantImbalance(2.0, np.pi - 0.5)),
    "vertical_load": (machine.PlantVerticalLoad(20.0),),
    "vertical_coulomb": (machine.PlantVerticalCoulomb(10.0),),
    "vertical_viscous": (machine.PlantVerticalViscous(2000.0),),
    "horizontal_coulomb": (machine.PlantHorizontalCoulomb(10.0, surplus=0.2),),
    "horizontal_viscous": (machine.PlantHorizontalViscous(50.0, 1.2),),
    "drawbar": (machine.PlantDrawbar(10.0), machine.PlantDrawbar(-10.0)),
    "cable_spring": (machine.PlantCableSpring(20.0),),
    "vertical_spring": (machine.PlantVerticalSpring(1000.0, 0.2),),
    "speed_gain": (drive.PlantSpeedGain(0.1, 0.2),),
    "speed_lag": (drive.PlantSpeedLag(0.1, 0.8),),
    "speed_ripple": (
        drive.PlantSpeedRipple(0.1, 8.0, 0.4, 0.3, 0.7),
        drive.PlantSpeedRipple(0.1, 8.0, -0.4, 0.3, -0.7),
    ),
    "backlash": (drive.PlantBacklash(0.1),),
    "sinkage_gain": (sensors.PlantSinkageGain(0.1, 0.1),),
    "sinkage_drift": (sensors.PlantSinkageDrift(1e-4),),
    "travel_gain": (sensors.PlantTravelGain(0.1, 0.1), sensors.PlantTravelGain(0.1, -0.1)),
    "measurement_delay": (sensors.PlantMeasurementDelay(0.1),),
    "channel_delay": (sensors.PlantChannelDelay(0.1),),
    "measurement_filter": (sensors.PlantMeasurementFilter(0.1),),
    "damaged_grouser": (unlisted.DamagedGrouser(0.5, 0.7), unlisted.DamagedGrouser(0.5, -0.7)),
    "healing": (unlisted.Healing(0.5),),
    "swing": (unlisted.Swing(0.3),),
    "thixotropy": (unlisted.Thixotropy(0.5),),
    "rise_and_fall": (unlisted.RiseAndFall(0.4),),
    "critical_speed": (unlisted.CriticalSpeed(0.5, 0.9),),
    "catch": (unlisted.Catch(20.0, 0.1, 0.15), unlisted.Catch(20.0, -0.25, 0.15)),
    "sinkage_drag": (unlisted.SinkageDrag(200.0),),
    "jamming_guide": (unlisted.JammingGuide(1000.0),),
    "travel_lift": (unlisted.TravelLift(300.0), unlisted.TravelLift(-300.0)),
    "drive_crosstalk": (sensors.DriveCrosstalk(1e-3),),
}
DIRECTED = [name for name, parts in PARTS.items() if len(parts) > 1]


# The reference model lowers the sand at x < 0, whichever way the wheel turns: its own convention,
# and no image of itself.
LEVEL = law("height_decrease", -1.0)


def ran(part: Part, asked: PlannedRun) -> PlantReading:
    return run_plant([LEVEL, part], asked, ZETA, settings=COARSE)


def apart(forward: PlantReading, backward: PlantReading) -> float:
    z, x = forward.z - backward.z, forward.x + backward.x
    return max(float(np.abs(z).max()), float(np.abs(x).max()))


def test_every_mechanism_that_can_be_drawn_is_mirrored_here():
    named = {name for names in CATALOGUE.values() for name in names}
    assert set(PARTS) == named | set(UNLISTED)


@pytest.mark.parametrize("name", [name for name in PARTS if name != "height_decrease"])
def test_a_mechanism_goes_backward_as_its_mirror_image_goes_forward(name):
    parts = PARTS[name]
    forward = ran(parts[0], FORWARD)
    # It gets somewhere.
    assert forward.x[-1] > 0.3
    assert apart(forward, ran(parts[-1], BACKWARD)) < CORNER


@pytest.mark.parametrize("name", DIRECTED)
def test_a_mechanism_fixed_in_space_or_to_the_wheel_does_not_mirror_by_itself(name):
    part = PARTS[name][0]
    assert apart(ran(part, FORWARD), ran(part, BACKWARD)) > SEEN


@pytest.mark.parametrize("name", list(PARTS))
def test_a_run_that_reverses_half_way_can_be_made(name):
    run = ran(PARTS[name][0], REVERSED)
    assert np.isfinite([run.x, run.z, run.omega]).all()
    assert 0 < np.argmax(run.x) < len(run.x) - 1


def test_a_rail_goes_as_far_back_as_the_wheel_is_to_go():
    far = profile((0.0, 0.2, 1.5, 4.0), (0.0, 0.0, -3.0, -3.0))
    assert ran(machine.PlantDrawbar(1.0), far).x[-1] < -1.0


def test_sand_and_surface_vary_on_both_sides_of_the_start():
    random = np.random.default_rng(0)
    kinds = {}
    while len(kinds) < 5:
        kind, values = draw_variation(random)
        kinds[kind] = RandomCurve(values)
    places = jnp.linspace(-5, -1, 200)
    assert np.ptp(np.asarray(kinds["sinusoid"](places))) > 1
    # A draw of some knots of order one each.
    assert np.ptp(np.asarray(kinds["smooth"](places))) > 0.3
    # What lies ahead only is not met behind.
    for kind in ("step patch", "step", "ramp"):
        assert np.ptp(np.asarray(kinds[kind](places))) < 1e-12  # but for a smooth step's far end


def test_a_drive_that_turns_back_crosses_twice_its_play():
    ahead, back = np.ones(1000), -np.ones(1000)
    backlash = drive.PlantBacklash(play=0.1, snap=1e-3)

    def lost(course: np.ndarray) -> np.ndarray:
        missed = np.abs(course) - np.abs(backlash.follow(course))
        return drive.SPEED_INTERVAL * np.array([missed[:1000].sum(), missed[1000:].sum()])

    np.testing.assert_allclose(lost(np.r_[ahead, back]), [0.1, 0.2], rtol=0, atol=BETWEEN)
    np.testing.assert_allclose(
        lost(np.r_[ahead, 0 * back, ahead]), [0.1, 0.0], rtol=0, atol=BETWEEN
    )
    # One that turns back in the middle of its play has the rest of it to cross, and the other half.
    np.testing.assert_allclose(
        lost(np.r_[0 * ahead[25:], ahead[:25], back]), [0.05, 0.15], rtol=0, atol=BETWEEN
    )


def pulls(effect, places: Sequence[float], omega: Callable[[int], float]) -> np.ndarray:
    """What a load pulls along x at places that the axle comes by one after another [N]."""
    nought, radius, dt = jnp.zeros(()), jnp.asarray(0.15), jnp.asarray(0.01)

    def one(memory, at):
        position, turns = jnp.stack([at[0], nought]), at[1]
        moment = StepContext(nought, dt, position, jnp.zeros(2), nought, turns, turns, radius)
        felt = effect.load(position, jnp.zeros(2), moment, memory)[0]
        return effect.advance(memory, moment), felt

    given = jnp.asarray([[x, omega(number)] for number, x in enumerate(places)])
    return np.asarray(jax.lax.scan(one, effect.begin(jnp.zeros(2)), given)[1])


THERE = np.linspace(0, 0.6, 401)


def test_a_catch_holds_the_carriage_back_from_either_side():
    both = np.r_[THERE, THERE[::-1]]
    felt = pulls(unlisted.Catch(20.0, 0.2, 0.2), both, lambda k: 1.0 if k < 401 else -1.0)
    ahead, back = felt[:401], felt[401:]
    assert ahead.max() == back.min() == 0
    assert ahead.min() == pytest.approx(-20, rel=SLIPS)
    assert back.max() == pytest.approx(20, rel=SLIPS)
    # Let go before it slips off, the spring pulls back the same way.
    half = pulls(unlisted.Catch(20.0, 0.2, 0.2), [0.1, 0.3, 0.25], lambda k: (1.0, 1.0, -1.0)[k])
    np.testing.assert_allclose(half, [0, -10, -5])


def test_sand_is_piled_up_on_either_side():
    both = np.r_[THERE, THERE[::-1]]
    felt = pulls(sand.PlantBulldozing(10.0, 0.2), both, lambda k: 1.0 if k < 401 else -1.0)
    assert felt[400] == pytest.approx(-10)
    assert felt[-1] == pytest.approx(10)


def test_a_cable_pulls_back_to_the_start_from_either_side():
    for bend in (-0.2, 0.3):
        felt = pulls(machine.PlantCableSpring(20.0, bend), [-5.0, -1.0, 1.0, 4.0], lambda k: 1.0)
        assert np.all(felt * [1, 1, -1, -1] > 0)
