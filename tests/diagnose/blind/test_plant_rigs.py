"""Rigs of the plant and its mechanisms, by momentum, similarity and equations solved apart."""

from dataclasses import replace
from math import gamma

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from diagnose.blind.generation.random_mechanisms import effect_names
from diagnose.blind.generation.random_rigs import SCALES, draw_rig, part_for, strength_of
from diagnose.blind.generation.settings import DEFAULT_GENERATION, DEFAULT_RIGS
from diagnose.blind.plant import bed, drive, force_sensors, machine, sand, sensors
from diagnose.blind.plant.plant import GROUPS, PlantChange, make_plant, run_plant, standing_start
from diagnose.blind.plant.rig import DEFAULT_RIG, GRAVITY, PlantRig
from diagnose.blind.plant.run_plan import PlannedRun, draw_sweep
from diagnose.blind.plant.sensors import PlantReading
from drftjax.effects.base import StepContext

# A standing wheel of the plant moves by its width at rest, a hundredth of the model's [m].
STANDS = 2e-6
# Momentum over a run: forces every 10 ms, of steps of a few milliseconds, over ramps of a second.
IMPULSE = 5e-3
# A wheel stands half a per cent deeper than it must, on some forty plates, not an integral.
CARRIED = 0.015
# Steps differ between two similar rigs, as each has the step of a fit to it [-].
SIMILAR = 2e-3
# Two stores advanced by implicit Euler, of first order in the step, and the same by Runge-Kutta.
STORES = 1e-2
# A closed formula is met but for rounding.
EXACT = 1e-12
# Eight plates along a grouser's face in place of an integral.
FACES = 0.02

SHORT = PlannedRun.held(20.0, 1.0, 1.5, 1.0, rest=0.5, end=0.5)
SMOOTH = PlantRig(0.06, 0.04, 0, mass_x=1.0, mass_z=1.5)
DRIVEN = replace(DEFAULT_RIG, is_driven=True)


@pytest.mark.parametrize(("rig", "zeta"), [(DEFAULT_RIG, 0.78), (SMOOTH, 1.2)])
def test_a_wheel_that_stands_stays(rig, zeta):
    run = run_plant((), PlannedRun((0.0, 1.0, 24.0), (0.0, 0.0, 0.0), rig.mass_z), zeta, rig=rig)
    assert np.ptp(run.z) < STANDS
    assert np.ptp(run.x) < STANDS


def test_a_smooth_wheel_stands_where_the_integral_of_the_law_carries_it():
    """Rim of any size, coefficients off their usual values, stress by a power of depth."""
    factors = (1.1, 0.9, 1.2, 0.95, 0.8, 1.0, 1.0, 1.0, 1.0)
    rig = replace(SMOOTH, stress_factors=factors)
    zeta, power, reference = 1.4, 0.25, 0.004
    law = [bed.PlantDepthHardening(power, reference)]
    plant = make_plant(law, ("stress PlantDepthHardening",), zeta, rig.mass_z, rig=rig)
    sinkage = standing_start(plant)
    a00, a10, b11, b01, bm11 = 1e6 * np.array([0.206, 0.169, 0.212, 0.358, 0.055]) * factors[:5]

    def upward(place: float) -> float:
        """Of the rim at an angle from straight down, on its way straight down [N/rad]."""
        depth = rig.radius * np.cos(place) - (rig.radius - sinkage)
        stress = a00 + b01 + (a10 + b11 + bm11) * np.cos(2 * place)
        return zeta * stress * depth * (depth / reference) ** power * rig.radius * rig.width

    edge = np.arccos(1 - sinkage / rig.radius)
    carried = quad(upward, -edge, edge)[0]
    assert carried == pytest.approx(rig.mass_z * GRAVITY, rel=CARRIED)


def test_forces_of_the_sand_balance_load_and_drawbar_over_a_run():
    run = run_plant([machine.PlantDrawbar(10.0)], SHORT, 0.78)
    duration = run.time[-1]
    # The wheel stands at both ends, so all impulses add up to zero.
    weight = DEFAULT_RIG.mass_z * GRAVITY * duration
    assert np.trapezoid(run.fz, run.time) == pytest.approx(weight, rel=IMPULSE)
    assert np.trapezoid(run.fx, run.time) == pytest.approx(10.0 * duration, abs=IMPULSE * weight)


def test_a_driven_carriage_goes_as_it_is_told_and_a_gain_moves_it_on():
    told = draw_sweep(np.random.default_rng(0), DRIVEN)["slip30a"]
    plain = run_plant((), told, 0.78, ("wheel",), rig=DRIVEN).since(told.logged_from)
    speed = told.carriage[-1]
    assert np.diff(plain.x) / 0.01 == pytest.approx(speed, rel=1e-9)
    assert speed == pytest.approx(0.7 * DRIVEN.radius * np.radians(told.speed[-1]))
    assert plain.time[0] == pytest.approx(told.logged_from)
    assert plain.fz.mean() == pytest.approx(DRIVEN.mass_z * GRAVITY, rel=IMPULSE)
    fast = run_plant([drive.PlantCarriageGain(0.02)], told, 0.78, ("wheel",), rig=DRIVEN)
    assert np.diff(fast.since(told.logged_from).x) / 0.01 == pytest.approx(1.02 * speed, rel=1e-9)


def test_similar_rigs_move_alike():
    """Lengths by a third, masses by its cube, times by its root: the law goes with gravity."""
    ratio = 1 / 3
    small = PlantRig(*(ratio * each for each in (0.150, 0.120)), 12, 0.006, 0.003)
    small = replace(small, mass_x=13.902 * ratio**3, mass_z=18.837 * ratio**3)
    slow = replace(SHORT, time=tuple(each / ratio**0.5 for each in SHORT.time), speed=SHORT.speed)
    slow = replace(slow, speed=tuple(each * ratio**0.5 for each in SHORT.speed))
    part = machine.PlantDrawbar(10.0)
    one = run_plant([part_for(part, small)], SHORT.on(small), 0.78, rig=small)
    other = run_plant([part], slow, 0.78)
    alike = other.at(one.time / ratio**0.5)
    assert one.z / ratio == pytest.approx(alike.z, rel=SIMILAR)
    assert one.x[-1] / ratio == pytest.approx(alike.x[-1], rel=SIMILAR)
    # The force of a single row may jump where a plate begins to lead.
    assert np.median(one.fz) / ratio**3 == pytest.approx(np.median(alike.fz), rel=SIMILAR)
    assert np.median(one.torque) / ratio**4 == pytest.approx(np.median(alike.torque), rel=SIMILAR)


def test_every_effect_of_the_plant_has_a_scale_and_a_strength():
    effects = [kind for group in GROUPS.values() for kind in group]
    assert set(effects) <= set(SCALES)
    for kind in effects:
        part = kind(**{next(iter(SCALES[kind])): 0.5})
        assert strength_of(part) == 0.5
        assert strength_of(part_for(part, DEFAULT_RIG)) == pytest.approx(0.5)
    heavy = replace(DEFAULT_RIG, radius=0.3, mass_z=2 * DEFAULT_RIG.mass_z)
    assert strength_of(part_for(machine.PlantCableSpring(10.0), heavy)) == pytest.approx(10.0)
    assert strength_of(part_for(sand.PlantBulldozing(10.0), heavy)) == pytest.approx(20.0)
    longer = PlantChange(lambda s: s.wheel.radius, 0.002, "radius")
    assert strength_of(part_for(longer, heavy)) == pytest.approx(0.004)


def test_rigs_are_drawn_within_their_ranges_on_sand_that_carries_them():
    random = np.random.default_rng(1)
    drawn = [draw_rig(random, DEFAULT_GENERATION) for _ in range(40)]
    others = [each for each in drawn if each.rig.radius != DEFAULT_RIG.radius]
    assert 10 < len(others) < 30
    assert any(each.rig.grouser_count == 0 for each in others)
    for each in others:
        assert 0.040 <= each.rig.radius <= 0.300
        assert 1.0 <= each.rig.mass_z <= 60.0
        assert 20 <= 1 / each.interval <= 500
    for each in others[:2]:
        plant = make_plant((), (), each.zeta, each.rig.mass_z, rig=each.rig)
        least, greatest = DEFAULT_RIGS.sinkage
        assert least <= standing_start(plant) / each.rig.radius <= greatest
    held = [draw_rig(random, DEFAULT_GENERATION, needs_grousers=True) for _ in range(30)]
    assert all(each.rig.grouser_count for each in held)


def test_a_driven_carriage_shows_forces_and_no_friction_of_its_own():
    driven = set(effect_names(is_driven=True))
    assert {"force_gain", "torque_friction", "carriage_gain", "vertical_compliance"} <= driven
    assert not driven & {"drawbar", "horizontal_coulomb", "speed_lag", "channel_delay"}


def _moment(vx: float, omega: float, dt: float = 0.01) -> StepContext:
    zero, still = jnp.zeros(()), jnp.zeros(2)
    velocity = jnp.asarray([vx, 0.0])
    turns = jnp.asarray(omega)
    return StepContext(zero, jnp.asarray(dt), still, velocity, zero, turns, turns, jnp.asarray(0.1))


def test_slip_sinkage_follows_its_equations_and_saturates():
    effect = bed.PlantSlipSinkage(rate=0.2, length=0.1)
    vx, omega = 0.03, 0.5  # a slip ratio of 0.4
    moment, memory = _moment(vx, omega, 0.04), effect.begin()
    for _ in range(200):
        memory = effect.advance(memory, moment)

    def rates(_, stores):
        first, second = stores
        return [0.02 - 2 * vx * first / 0.1, 2 * vx * (first - second) / 0.1]

    solved = solve_ivp(rates, (0, 8.0), [0.0, 0.0], rtol=1e-9, atol=1e-12).y[:, -1]
    height = float(effect.height(jnp.zeros(()), jnp.zeros(1), memory)[0])
    assert height == pytest.approx(-0.2 * solved.sum(), rel=STORES)
    settled = -0.2 * 0.1 * 0.4 / (1 - 0.4)
    assert height == pytest.approx(settled, rel=0.05)
    assert height > settled


def test_a_heap_holds_a_locked_wheel_back_most_and_a_standing_one_not_at_all():
    heap = sand.PlantHeap(force=4.0, sinkage=0.02, power=2.0, braking=3.0, lift=0.25)
    deep = jnp.asarray([0.0, -0.03])

    def load(vx: float, omega: float) -> np.ndarray:
        moment = _moment(vx, omega)
        return np.asarray(heap.load(deep, moment.velocity, moment, ()))

    rolling = 4.0 * 1.5**2
    np.testing.assert_allclose(load(1.0, 10.0), [-rolling, 0.25 * rolling], rtol=1e-4)
    np.testing.assert_allclose(load(1.0, 0.0), [-4 * rolling, rolling], rtol=1e-4)
    np.testing.assert_allclose(load(-1.0, 0.0), [4 * rolling, rolling], rtol=1e-4)
    np.testing.assert_array_equal(load(0.0, 0.0), [0, 0])


def test_shadowed_faces_lose_the_area_of_the_integral():
    share, power = 0.4, 2.5
    cut = DEFAULT_RIG.wheel(0.0005).cut()
    plates = cut.plates(jnp.asarray(0.1))
    effect = machine.PlantGrouserShadowing(share, power)
    left = effect.place(plates, jnp.asarray(0.1)).area
    face = float(DEFAULT_RIG.width * DEFAULT_RIG.grouser_height)
    faces = round(float(plates.area[np.asarray(left) < np.asarray(plates.area)].sum()) / face)
    lost = float((plates.area - left).sum()) / (faces * face)
    # The whole integral of exp(-(u/s)^p), of which next to nothing lies beyond the tip.
    assert faces >= 2 * 6
    assert lost == pytest.approx(share * gamma(1 + 1 / power), rel=FACES)


READING = PlantReading(
    time=np.linspace(0, 1, 101),
    x=np.linspace(0, 0.1, 101),
    z=np.full(101, -0.02),
    omega=np.linspace(-1, 1, 101),
    fx=np.linspace(-20, 60, 101),
    fz=np.linspace(180, 190, 101),
    torque=np.linspace(-5, 20, 101),
)


def test_sensors_of_force_and_torque_read_by_their_formulas():
    r = READING
    askew = force_sensors.PlantForceCrosstalk(0.1).read(r)
    assert np.hypot(askew.fx, askew.fz) == pytest.approx(np.hypot(r.fx, r.fz), rel=EXACT)
    angle = np.arctan2(askew.fz, askew.fx) - np.arctan2(r.fz, r.fx)
    assert angle == pytest.approx(-0.1, rel=1e-9)
    off = force_sensors.PlantForceOffset(5.0, np.arctan2(4, 3)).read(r)
    assert off.fx - r.fx == pytest.approx(3.0)
    assert off.fz - r.fz == pytest.approx(4.0)
    more = force_sensors.PlantForceGain(0.1, 0.5).read(r)
    assert more.fz == pytest.approx(1.1 * r.fz)
    assert more.fx == pytest.approx(1.05 * r.fx)
    assert force_sensors.PlantTorqueOffset(0.3).read(r).torque - r.torque == pytest.approx(0.3)
    bearing = force_sensors.PlantTorqueFriction(0.5, 0.0).read(r).torque - r.torque
    assert bearing == pytest.approx(0.5 * np.sign(r.omega))
    gain = force_sensors.PlantTorqueGain(0.1, 0.5).read(r)
    assert gain.torque[-1] == pytest.approx(r.torque[-1] * 1.05)
    frame = force_sensors.PlantVerticalCompliance(1e-5, 185.0, 1.0).read(r)
    assert frame.z == pytest.approx(r.z - 1e-5 * r.fz)
    late = sensors.PlantChannelDelay(0.1, "x").read(r)
    assert late.x[10:] == pytest.approx(r.x[:-10], abs=EXACT)
    assert np.array_equal(late.z, r.z)
