"""Influence of effects that forces, torque and a driven carriage show, against algebra.

A smooth wheel turns on at an even 2 rad/s over two turns: on a free carriage, and on a driven one
that goes at half of the rim's speed, or drags the wheel along while it is locked.
"""

import math
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.base import StepContext
from drftjax.effects.wheel import GrouserShadowing
from drftjax.physics.rig import DrivenCarriage, Rig
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.simulator import Simulator
from tests.helpers.effect_runs import KNOWN, RIM, built, driven, rows, simulator, vector

# What an effect does is worked out for steady driving; the runs come near to that, not more.
STEADY = 0.03
# Sums and products of some doubles in another order.
CLOSE = 1e-9
# Two programs whose steps round otherwise: a search for a root stops at 1e-8 of sqrt(r g) [m], and
# a force of some hundred newtons follows its velocity [N].
REACHED, FOUND = 2e-8, 2e-4
# A tilt of so many radians, and its square: what a share of the other axis leaves out [-].
TILT = 0.02
# Nine faces of a third more plates against the outer two thirds of nine: midpoints of a stress
# that is linear in depth, but for those plates that the surface cuts.
CUT = 5e-3
# A way of ten lengths on, e^-10 is still to come; the step adds half of itself over the length.
SETTLED = 2e-3
SPEED, DT, EVERY, SECONDS = 2.0, 2e-3, 10, 2 * np.pi
STEPS = EVERY * round(SECONDS / DT / EVERY)
HOLD, LOCKED = np.full(STEPS, SPEED), np.zeros(STEPS)
WEIGHT, RADIUS = 18.837 * 9.81, 0.150
CARRIAGE = 0.5 * RADIUS * SPEED
NO_GROUSERS = ("grouser_height", "grouser_shadowing")


@cache
def program(on_driven: bool):
    left_out = NO_GROUSERS if on_driven else (*NO_GROUSERS, "carriage_gain")
    rig = Rig(carriage=DrivenCarriage()) if on_driven else Rig()

    def run(values, start, omega, vx):
        sim = replace(simulator(RIM), rig=rig, effects=built(values, left_out))
        return rows(sim, start, omega, DT, EVERY, vx)

    return jax.jit(run)


def ran(on_driven: bool, omega=HOLD, vx=CARRIAGE, start=None, **given):
    start = driven(True, SPEED) if start is None else start
    values = jnp.asarray(vector(**given))
    return jax.tree.map(np.asarray, program(on_driven)(values, start, omega, vx))


@cache
def plain(on_driven: bool):
    return ran(on_driven)


def last_turn(channel) -> float:
    return float(np.mean(channel[-(len(channel) // 2) :]))


# Drive


def test_a_driven_carriage_that_runs_fast_is_one_that_is_told_to():
    fast, told = ran(True, carriage_gain={"gain": 0.03}), ran(True, vx=1.03 * CARRIAGE)
    for channel in ("x", "z", "slip"):
        np.testing.assert_allclose(getattr(fast, channel), getattr(told, channel), atol=REACHED)
    for channel in ("fx", "fz", "torque"):
        np.testing.assert_allclose(getattr(fast, channel), getattr(told, channel), atol=FOUND)
    # It slips less, and so pulls less.
    assert last_turn(fast.slip) == pytest.approx(1 - 0.5 * 1.03, rel=CLOSE)
    assert last_turn(fast.fx) < last_turn(plain(True).fx) - 0.5


def test_derivatives_by_the_speed_of_a_driven_carriage_are_those_of_its_gain():
    start, rig = driven(True, SPEED), Rig(carriage=DrivenCarriage())

    def run(excess, gain):
        sim = replace(simulator(RIM), rig=rig, effects=(KNOWN["carriage_gain"](gain=gain),))
        output = rows(sim, start, HOLD, DT, EVERY, (1 + excess) * CARRIAGE)
        return jnp.stack([getattr(output, each) for each in ("x", "z", "fx", "fz", "torque")])

    @jax.jit
    def along(at, change):
        return jax.jvp(run, at, change)

    told, fast = (along((0.0, 0.0), change)[1] for change in ((1.0, 0.0), (0.0, 1.0)))
    np.testing.assert_allclose(told, fast, rtol=CLOSE, atol=CLOSE * np.abs(fast).max())
    change = 1e-6
    ahead, behind = (along((excess, 0.0), (1.0, 0.0))[0] for excess in (change, -change))
    differences = (ahead - behind) / (2 * change)
    error = np.abs(differences - told) / np.abs(told).max(axis=1, keepdims=True)
    assert np.median(error, axis=1).max() < STEADY


def test_a_free_carriage_has_no_gain():
    with pytest.raises(InputError, match="carriage_gain needs a driven carriage"):
        replace(simulator(RIM), effects=(KNOWN["carriage_gain"](gain=0.02),)).check()


# Sensors


def test_a_free_wheel_reads_its_weight_in_vain_where_the_sensor_is_off():
    """On a free carriage the sand bears the weight and does not push."""
    off = ran(False, force_offset={"fx_offset": 2.0, "fz_offset": -3.0})
    assert last_turn(off.fz) == pytest.approx(WEIGHT - 3, abs=0.05)
    assert last_turn(off.fx) == pytest.approx(2, abs=0.05)
    gain = ran(False, force_gain={"fx_gain": 0.5, "fz_gain": 0.03})
    assert last_turn(gain.fz) == pytest.approx(1.03 * WEIGHT, abs=0.05)
    np.testing.assert_allclose(gain.fx, 1.5 * plain(False).fx, rtol=0, atol=FOUND)


def test_a_tilted_sensor_reads_a_share_of_the_other_axis():
    read = ran(True, force_crosstalk={"fz_in_fx": TILT, "fx_in_fz": -TILT})
    true = np.stack([plain(True).fx, plain(True).fz])
    cosine, sine = np.cos(TILT), np.sin(TILT)
    turned = np.array([[cosine, sine], [-sine, cosine]]) @ true
    largest = np.abs(true).max()
    np.testing.assert_allclose([read.fx, read.fz], turned, rtol=0, atol=TILT**2 * largest)


@pytest.mark.parametrize("sense", [1, -1])
def test_the_motor_does_the_work_of_sand_and_bearing(sense):
    start, omega = driven(True, SPEED), sense * HOLD
    start = replace(start, omega=sense * start.omega)
    given = {"omega": omega, "vx": sense * CARRIAGE, "start": start}
    bare, held = ran(True, **given), ran(True, torque_friction={"friction": 0.2}, **given)
    work = np.mean((held.torque - bare.torque)[1:] * held.omega[1:]) * SECONDS
    assert work == pytest.approx(0.2 * SPEED * SECONDS, rel=CLOSE)


def test_torque_is_read_off_by_a_constant_and_in_ratio():
    off, gain = ran(True, torque_offset={"offset": 0.2}), ran(True, torque_gain={"gain": 0.03})
    true = plain(True).torque
    assert last_turn(true) > 1
    np.testing.assert_allclose(off.torque, true + 0.2, rtol=0, atol=FOUND)
    np.testing.assert_allclose(gain.torque / true, 1.03, rtol=FOUND)


def test_a_frame_that_gives_hides_how_high_the_wheel_stands():
    """Read under the weight, the start is truly higher by what the frame gives."""
    give, moving = 1e-5, driven(True, SPEED)
    there = replace(moving, position=moving.position.at[1].add(give * WEIGHT))
    truth = ran(False, start=there)
    read = ran(False, vertical_compliance={"compliance": give})
    np.testing.assert_allclose(read.z, truth.z - give * truth.fz, rtol=0, atol=REACHED)
    np.testing.assert_allclose(read.sinkage, -read.z, rtol=CLOSE)
    # In the end it stands where it stood, and is read the weight's share too deep.
    too_deep = last_turn(plain(False).z) - last_turn(read.z)
    assert too_deep == pytest.approx(give * WEIGHT, rel=STEADY)


# Wheel


def test_only_the_outer_part_of_a_shadowed_grouser_carries():
    """Against the bare wheel's own plates, without those of the faces' inner third."""
    height, share = 0.018, 1 / 3
    bare = Simulator(GrouserWheel(plate_size=0.002))
    at = (jnp.array([0.0, -0.03]), jnp.array([0.05, -0.01]), jnp.asarray(0.1), jnp.asarray(0.5))
    load = bare.plate_load(*at, jnp.asarray(0.8))
    plates = load.plates
    outward = np.asarray(plates.x * plates.normal_x + plates.z * plates.normal_z)
    far = np.hypot(plates.x, plates.z)
    # A face looks along the rim; its centre is as far out as the tip's, but for half a thickness.
    face = (np.abs(outward) < 0.5 * far) & (np.asarray(plates.area) > 0)
    inner = face & (far < RADIUS + share * height)
    assert inner.sum() == face.sum() / 3
    forces = np.stack([np.asarray(each) for each in load.wrenches()])
    expected = forces[:, ~inner].sum(axis=1)
    shadowed = replace(bare, effects=(GrouserShadowing(share=share),))
    found = np.asarray(shadowed.wrench(*at, jnp.asarray(0.8)))
    whole = forces.sum(axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=CUT * np.abs(whole).max())
    assert np.abs(whole - expected).max() > 4 * CUT * np.abs(whole).max()


def test_a_shadow_is_a_share_and_needs_grousers():
    with pytest.raises(InputError, match="shadowed share"):
        replace(simulator(), effects=(GrouserShadowing(share=1.2),)).check()
    with pytest.raises(InputError, match="grouser_shadowing needs a wheel with grousers"):
        replace(simulator(RIM), effects=(GrouserShadowing(share=0.2),)).check()


# Terrain


def moment(vx: float, omega: float, dt: float) -> StepContext:
    nought, turning = jnp.zeros(()), jnp.asarray(omega)
    return StepContext(
        nought,
        jnp.asarray(dt),
        jnp.zeros(2),
        jnp.array([vx, 0.0]),
        nought,
        turning,
        turning,
        jnp.asarray(RADIUS),
    )


def surface(name: str, vx: float, omega: float, seconds: float, **numbers: float) -> float:
    effect, dt = KNOWN[name](**numbers), 1e-3
    now, steps = moment(vx, omega, dt), round(seconds / dt)
    memory = jax.lax.fori_loop(0, steps, lambda _, m: effect.advance(m, now), effect.begin())
    return float(effect.plane(jnp.zeros(()), memory)[0])


def test_slip_sinkage_settles_at_an_even_slip_and_digs_on_where_the_wheel_spins():
    rate, length, omega = 0.1, 0.1, 1.0
    for slip in (0.3, -0.2):
        vx = (1 - slip) * RADIUS * omega
        depth = -surface("slip_sinkage", vx, omega, 10 * length / vx, rate=rate, length=length)
        assert depth == pytest.approx(rate * length * abs(slip) / (1 - slip), rel=SETTLED)
    spinning = surface("slip_sinkage", 0.0, omega, 2.0, rate=rate, length=length)
    assert spinning == pytest.approx(surface("excavation", 0.0, omega, 2.0, rate=rate), rel=CLOSE)


def test_slip_ratio_softening_takes_its_share_of_a_slip_ratio_at_any_speed():
    effect = KNOWN["slip_ratio_softening"](loss=0.2)
    for scale in (0.2, 1.0, -5.0):
        for vx, slip in ((0.6, 0.4), (1.0, 0.0), (1.25, 0.2), (0.0, 1.0)):
            now = moment(vx * RADIUS * scale, scale, DT)
            assert float(effect.factor(now, ())) == pytest.approx(1 - 0.2 * slip, rel=CLOSE)


def test_slip_power_softening_is_a_hyperbola_a_logarithm_and_a_line():
    onset = 0.01

    def factor(slip: float, exponent: float) -> float:
        now = moment(-slip, 0.0, DT)
        return float(KNOWN["slip_power_softening"](exponent=exponent, onset=onset).factor(now, ()))

    # With an exponent of one all of zeta is lost to the hyperbola of slip_softening.
    hyperbola = KNOWN["slip_softening"](loss=1.0, half=onset).factor(moment(-0.03, 0.0, DT), ())
    assert factor(0.03, 1.0) == pytest.approx(float(hyperbola), rel=CLOSE)
    # A small exponent: ten times the slip beyond the onset costs as much again. Each of a
    # thousandth is off by its square at most, and the onset by a hundredth of a logarithm.
    lost = [1 - factor(onset * 10.0**k, 1e-3) for k in (2, 3, 4)]
    assert lost[2] - lost[1] == pytest.approx(lost[1] - lost[0], rel=2e-2)
    # Far below the onset: in proportion to slip, off by its share of the onset.
    assert 1 - factor(1e-6, 0.5) == pytest.approx(0.5 * 1e-6 / onset, rel=2e-4)


def test_creeping_friction_lies_between_dry_and_viscous():
    now, width = moment(0.0, 0.0, DT), 1e-4

    def force(name, speed, **numbers):
        velocity = jnp.full(2, speed)
        return float(KNOWN[name](**numbers).load(jnp.zeros(2), velocity, now, ())[1])

    for speed in (-3 * width, 0.5 * width, 2 * width):
        narrow = force("vertical_creep_friction", speed, force=6.0, creep=width)
        assert narrow == pytest.approx(force("vertical_coulomb", speed, force=6.0), rel=CLOSE)
    # A hundredth of the width: tanh u = u - u^3/3.
    wide = force("vertical_creep_friction", width, force=6.0, creep=100 * width)
    damped = force("vertical_viscous", width, damping=6.0 / (100 * width))
    assert wide == pytest.approx(damped * (1 - 1e-4 / 3), rel=1e-8)


def test_a_guide_breaks_away_from_more_than_it_slides_with():
    width, at = 1e-4, moment(0.0, 0.0, DT)
    friction = KNOWN["vertical_creep_friction"](force=6.0, breakaway=4.0, creep=width)

    def force(speed):
        return float(friction.load(jnp.zeros(2), jnp.full(2, speed), at, ())[1])

    # Five widths on, a part 1/e of the breakaway is left (Tustin); the rest of it far beyond.
    assert force(5 * width) == pytest.approx(-(6 + 4 / math.e) * math.tanh(5), rel=CLOSE)
    assert force(-5 * width) == -force(5 * width)
    assert force(200 * width) == pytest.approx(-6.0, rel=CLOSE)
    assert force(0.0) == 0


def test_a_surface_spring_pushes_up_in_proportion_to_the_whole_sinkage():
    spring = KNOWN["surface_spring"](stiffness=800.0)
    for sinkage in (0.0, 0.01, 0.03):
        force = spring.load(jnp.array([0.2, -sinkage]), jnp.zeros(2), moment(0.1, 1.0, DT), ())
        np.testing.assert_allclose(force, [0.0, 800.0 * sinkage], atol=CLOSE)


def test_stress_as_a_power_of_depth_is_a_straight_line_in_logarithms_and_as_before_at_20_mm():
    excess, bare = -0.3, simulator(RIM)
    power = replace(bare, effects=(KNOWN["depth_power"](excess=excess),))
    at = jnp.array([0.0, -0.03]), jnp.array([0.0, -1e-2]), jnp.zeros(()), jnp.zeros(())
    plain, changed = (sim.plate_load(*at, jnp.ones(())) for sim in (bare, power))
    deep = np.asarray(plain.motion.depth) > 1e-4
    ratio = np.asarray(changed.stress_z)[deep] / np.asarray(plain.stress_z)[deep]
    depth = np.asarray(plain.motion.depth)[deep] / 0.02
    line = np.polyfit(np.log(depth), np.log(ratio), 1)
    np.testing.assert_allclose(line, [excess, 0.0], rtol=0, atol=CLOSE)


def test_hardening_by_sinkage_is_a_straight_line_in_logarithms_and_as_before_at_20_mm():
    effect, now = KNOWN["sinkage_hardening"](excess=0.7), moment(0.1, 1.0, DT)
    sinkages = np.array([0.005, 0.01, 0.02, 0.04])
    at = [replace(now, position=jnp.array([0.0, -each])) for each in sinkages]
    factors = [float(effect.factor(each, ())) for each in at]
    np.testing.assert_allclose(factors, (sinkages / 0.02) ** 0.7, rtol=CLOSE)
    # A wheel above the sand has some strength left, and no infinity.
    above = replace(now, position=jnp.array([0.0, 0.01]))
    assert float(effect.factor(above, ())) == pytest.approx(0.05**0.7, rel=CLOSE)


def test_slip_sinkage_lowers_a_wheel_by_what_its_slip_digs():
    output = ran(False, slip_sinkage={"rate": 0.05, "length": 0.1})
    slip = last_turn(plain(False).slip)
    lower = last_turn(plain(False).z) - last_turn(output.z)
    assert lower == pytest.approx(0.05 * 0.1 * slip / (1 - slip), rel=STEADY)
    # The sand bears it as before.
    assert last_turn(output.slip) == pytest.approx(slip, rel=STEADY)


def test_a_heap_holds_a_driven_carriage_back_by_its_size():
    given = {"resistance": 2.0, "lift": 0.0, "braking": 3.0}
    for omega, growth in ((HOLD, 1.0), (LOCKED, 4.0), (-HOLD, 4.0)):
        bare, heap = ran(True, omega), ran(True, omega, heap=given)
        np.testing.assert_allclose(heap.z, bare.z, rtol=0, atol=REACHED)
        size = 2.0 * growth * (bare.sinkage / 0.02) ** 2
        np.testing.assert_allclose((bare.fx - heap.fx)[1:], size[1:], rtol=STEADY / 10)


def test_a_heap_before_a_free_wheel_pulls_as_a_drawbar_does_and_bears_its_share():
    heap = ran(False, heap={"resistance": 2.0, "lift": 0.0})
    force = 2.0 * (last_turn(heap.sinkage) / 0.02) ** 2
    pulled = ran(False, drawbar={"force": force})
    slips = [last_turn(each.slip) - last_turn(plain(False).slip) for each in (heap, pulled)]
    assert slips[0] == pytest.approx(slips[1], rel=STEADY)
    lifted = ran(False, heap={"resistance": 0.0, "lift": 1.0})
    force = last_turn(lifted.sinkage / 0.02) ** 2
    eased = ran(False, vertical_load={"force": -force})
    assert last_turn(lifted.z) == pytest.approx(last_turn(eased.z), rel=STEADY)
    assert last_turn(lifted.z) > last_turn(plain(False).z) + 1e-4
    # What sand and heap bear together, a sensor reads: the weight.
    assert last_turn(lifted.fz) == pytest.approx(WEIGHT, abs=0.05)


def test_a_wheel_that_stands_has_no_heap():
    effect = KNOWN["heap"](resistance=2.0, lift=1.0)
    still = effect.load(jnp.array([0.0, -0.03]), jnp.zeros(2), moment(0.0, 1.0, DT), ())
    np.testing.assert_array_equal(np.abs(still), 0)
