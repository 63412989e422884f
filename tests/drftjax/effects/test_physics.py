"""Influence of every effect on a run, against a few lines of algebra.

Two runs of a smooth wheel: `hold` turns on at an even 2 rad/s, over two turns; `starting` speeds up
to that from rest. One program makes the runs of all effects, most of them at zero.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.stress import DepthHardening, HeightDecrease, MomentumFlux, RateHardening
from drftjax.effects.wheel import GrouserHeight, Imbalance, WheelRadius
from drftjax.physics.state import State
from drftjax.physics.stress import Dynamic, plate_motion
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator
from tests.helpers.effect_runs import (
    KNOWN,
    RIM,
    driven,
    rows,
    simulator,
    typical,
    vector,
    with_effects,
)

# What an effect does is worked out for steady driving; the runs come near to that, not more.
STEADY = 0.03
# Where only rounding and the step itself lie between.
CLOSE = 1e-9
# Of a wave of 2 m a wheel feels the sand some 3 cm ahead of its axle: that much phase.
WAVE = 0.1
# A ripple locked to the angle loses half of its square, 1.25e-3: the wheel stays where it is slow.
LOST = 2e-3
# Of means over readings 20 ms apart.
SAMPLED = 5e-3
# Once a turn, sand that gives way makes an axle trail its centre by some per cent.
TRAILS = 0.1
# e^-6 of a loosening is still to come after two turns, of a loss of a tenth or two.
TO_COME = 1e-3
# The row nearest to a patch's centre is up to 3 mm off, of a width of 100: half of that squared.
CENTRE = 1e-4
# What a step of a millisecond turns at 1 rad/s.
PLAY = 1e-3
# Sums of a few doubles of order one; and a difference quotient errs by its half width's square,
# 1e-12 m2, times a sixth of the third derivative of 10 / m2: over 0.1 m ahead.
ROUNDING = QUOTIENT = 1e-12
SPEED, DT, EVERY = 2.0, 2e-3, 10
# Width at rest of the paper's wheel [m/s].
REST_SPEED = 5e-7 * np.sqrt(0.150 * 9.81)
# The phase of seven periods a turn is that of the angle at an even speed over the step: what the
# ripple itself adds in a step, times the ripple, is not in it.
UNTOLD_PHASE = 7 * SPEED * DT
SECONDS = 2 * 2 * np.pi / SPEED
# A velocity that is found to 1e-8 of sqrt(r g) leaves this of a force unbalanced [N], and a depth
# that is approached from step to step off by this [m].
FOUND, REACHED = 1.2e-8 * 18.837 / DT, 1.2e-8
STEPS = EVERY * round(SECONDS / DT / EVERY)
HOLD = np.full(STEPS, SPEED)
STARTING = SPEED * np.clip(DT * np.arange(1, STEPS + 1) / 2.0, 0, 1)
WEIGHT = 18.837 * 9.81
RADIUS, ZETA = 0.150, 0.7823


@cache
def start(moving: bool) -> State:
    if moving:
        return driven(True, SPEED)
    return replace(driven(True, 0.0), velocity=jnp.zeros(2))


@cache
def program():
    def run(values, state, omega):
        return rows(with_effects(RIM, values), state, omega, DT, EVERY)

    return jax.jit(run)


def ran(moving: bool, **given):
    output = program()(jnp.asarray(vector(**given)), start(moving), HOLD if moving else STARTING)
    return jax.tree.map(np.asarray, output)


hold = cache(partial(ran, True))
starting = cache(partial(ran, False))


def held(name: str, **shapes: float):
    return ran(True, **{name: typical(name) | shapes})


def size(name: str) -> float:
    (value,) = typical(name).values()
    return value


def advance(output) -> float:
    return output.x[-1] - output.x[0]


def last_turn(channel) -> float:
    """Mean over the last whole turn."""
    return float(np.mean(channel[-(len(channel) // 2) :]))


def near(value, expected, tolerance=STEADY):
    assert value == pytest.approx(expected, rel=tolerance)


# Drive


def test_speed_gain_makes_the_wheel_go_farther_in_proportion():
    near(advance(held("speed_gain")) / advance(hold()) - 1, size("speed_gain"))


def test_speed_lag_loses_the_way_of_one_lag():
    late, plain = ran(False, speed_lag={"lag": 0.1}), starting()
    near(plain.angle[-1] - late.angle[-1], 0.1 * SPEED, CLOSE)
    near(plain.x[-1] - late.x[-1], 0.1 * plain.vx[-1])


def test_speed_ripple_has_its_order_and_size_and_loses_nothing_over_a_turn():
    output = ran(True, speed_ripple={"cosine": 0.03, "sine": 0.04, "order": 7.0})
    ripple = output.omega / SPEED - 1
    near(np.abs(ripple).max(), 0.05)
    np.testing.assert_allclose(
        ripple[1:],
        0.03 * np.cos(7 * output.angle[1:]) + 0.04 * np.sin(7 * output.angle[1:]),
        rtol=0,
        atol=0.05 * UNTOLD_PHASE * 0.05,
    )
    near(output.angle[-1], hold().angle[-1], LOST)


def test_speed_harmonics_has_both_harmonics_and_loses_nothing_over_a_turn():
    given = {"cosine": 0.03, "sine": 0.02, "cosine2": -0.01, "sine2": 0.015, "order": 7.0}
    output = ran(True, speed_harmonics=given)
    ripple, phase = output.omega / SPEED - 1, 7 * output.angle
    first = 0.03 * np.cos(phase) + 0.02 * np.sin(phase)
    second = -0.01 * np.cos(2 * phase) + 0.015 * np.sin(2 * phase)
    np.testing.assert_allclose(
        ripple[1:], (first + second)[1:], rtol=0, atol=0.08 * UNTOLD_PHASE * 0.08
    )
    near(output.angle[-1], hold().angle[-1], LOST)


@pytest.mark.parametrize("play", [0.05, 0.004])
def test_backlash_loses_its_play_wider_or_narrower_than_the_regulariser(play):
    output = ran(False, backlash={"play": play})
    near(starting().angle[-1] - output.angle[-1], play)


def test_backlash_is_crossed_again_on_the_way_back():
    backlash, memory = KNOWN["backlash"](play=0.05), jnp.zeros(())
    dt, turned = jnp.asarray(1e-3), []
    for asked in (1.0, -1.0):
        lost = 0.0
        for _ in range(500):
            omega, memory = backlash.turn(jnp.asarray(asked), memory, dt, memory)
            lost += float(dt * (asked - omega))
        turned.append(lost)
    np.testing.assert_allclose(turned, [0.05, -0.10], rtol=0, atol=PLAY)


# Wheel


def test_a_larger_wheel_is_the_wheel_of_that_radius_and_goes_farther():
    output = held("wheel_radius")
    larger = PlainWheel(RADIUS + size("wheel_radius"), plate_size=0.0051)
    assert larger.rim_plates == RIM.rim_plates
    run = jax.jit(lambda: rows(simulator(larger), start(True), HOLD, DT, EVERY))()
    np.testing.assert_allclose(output.x, run.x, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(output.z, run.z, rtol=0, atol=CLOSE)
    assert advance(output) > advance(hold())


def test_wheel_radius_and_grouser_height_are_those_of_the_wheel_itself():
    sim = Simulator(GrouserWheel())
    for effect, wheel in (
        (WheelRadius(excess=0.003), GrouserWheel(radius=0.153)),
        (GrouserHeight(excess=-0.018), GrouserWheel(grouser_height=0.0)),
    ):
        changed = effect.adjust(sim).wheel
        np.testing.assert_allclose(changed.radius, wheel.radius, rtol=ROUNDING)
        np.testing.assert_allclose(
            changed.grouser_height, wheel.grouser_height, rtol=0, atol=ROUNDING
        )


def test_a_traced_strength_is_not_checked_and_one_of_the_whole_height_passes():
    def true_height(excess):
        sim = replace(Simulator(GrouserWheel()), effects=(GrouserHeight(excess=excess),))
        sim.check()
        return sim.adjusted().wheel.grouser_height

    assert float(jax.jit(true_height)(0.2)) == pytest.approx(0.218)
    assert float(jax.grad(true_height)(-0.1)) == pytest.approx(1)
    assert float(true_height(-0.018)) == pytest.approx(0, abs=CLOSE)
    with pytest.raises(InputError, match="true grouser height"):
        true_height(0.2)


def test_without_grousers_a_wheel_feels_as_its_bare_rim_does():
    absent = GrouserHeight(excess=-0.018).adjust(Simulator(GrouserWheel()))
    bare = Simulator(GrouserWheel(grouser_height=0.0))
    at = (jnp.array([0.0, -0.02]), jnp.array([0.05, -0.01]), jnp.asarray(0.1), jnp.asarray(0.5))
    wrench = [sim.wrench(*at, jnp.asarray(ZETA)) for sim in (absent, bare)]
    np.testing.assert_allclose(wrench[0], wrench[1], rtol=ROUNDING)


def test_eccentricity_shows_once_a_turn_and_travels_no_farther():
    along, up = 0.001, 0.002
    output = ran(True, eccentricity={"along": along, "up": up})
    angle, change = output.angle, output.z - hold().z
    half = len(change) // 2
    once = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)[half:]
    cosine, sine, mean = np.linalg.lstsq(once, change[half:], rcond=None)[0]
    # z is the axle's: where the centre stands above it, the axle stands lower.
    near(cosine, -up, TRAILS)
    near(sine, along, TRAILS)
    assert abs(mean) < 1e-3 * up
    # A radius larger by as much would go 25 mm farther.
    assert abs(advance(output) - advance(hold())) < 0.1 * up * 4 * np.pi


def test_imbalance_pulls_outward_with_the_square_of_the_speed():
    output = held("imbalance")
    change = output.z - hold().z
    # 0.8 N of a weight of 185 N that has sunk by 40 mm: a tenth of a millimetre at the least.
    assert np.abs(change).max() > 1e-4
    effect = Imbalance(up=0.2)
    pulls = []
    for angle, omega in ((0.0, 1.0), (np.pi / 2, 1.0), (0.0, 2.0)):
        moment = replace(_moment(), angle=jnp.asarray(angle), omega=jnp.asarray(omega))
        pulls.append(np.asarray(effect.load(jnp.zeros(2), jnp.zeros(2), moment, ())))
    # Up at the top; a quarter turn forward, forward.
    np.testing.assert_allclose(pulls, [[0, 0.2], [0.2, 0], [0, 0.8]], rtol=0, atol=ROUNDING)


def _moment():
    from drftjax.effects.base import StepContext

    nought = jnp.zeros(())
    one = jnp.ones(())
    return StepContext(nought, one, jnp.zeros(2), jnp.zeros(2), nought, one, one, one)


# Terrain


def test_loosening_follows_the_angle_turned_and_reaches_its_floor():
    output = held("loosening", decay=2.0)
    turned = output.time * SPEED
    loss = size("loosening")
    # The memory of a step is that of its start.
    expected = ZETA * (1 - loss * (1 - np.exp(-(turned[1:] - DT * SPEED) / 2.0)))
    np.testing.assert_allclose(output.zeta[1:], expected, rtol=CLOSE)
    near(output.zeta[-1], ZETA * (1 - loss), TO_COME)
    assert last_turn(output.z) < last_turn(hold().z)


def test_slip_softening_takes_the_share_of_the_slip_speed():
    output = held("slip_softening", half=0.01)
    slip = RADIUS * output.omega[-1] - output.vx[-1]
    near(output.zeta[-1], ZETA * (1 - size("slip_softening") * slip / (slip + 0.01)), CLOSE)


def test_terrain_variation_is_hardest_at_its_centre():
    output = held("terrain_variation", centre=0.6, width=0.1)
    at = int(np.argmax(output.zeta))
    # The row nearest to it: half of what a wheel goes from row to row, at 0.3 m/s.
    assert abs(output.x[at] - 0.6) < 0.3 * DT * EVERY / 2
    near(output.zeta[at], ZETA * (1 + size("terrain_variation")), CENTRE)
    patch = np.abs(output.x - 0.6) < 0.2
    assert np.mean((output.z - hold().z)[patch]) > 0  # firmer sand carries higher


def test_bulldozing_in_the_end_pulls_as_a_drawbar_does():
    piled, pulled = held("bulldozing", length=0.05), ran(True, drawbar={"force": 5.0})
    near(piled.slip[-1] - hold().slip[-1], pulled.slip[-1] - hold().slip[-1])
    # A sensor of the sand's force reads the pile too, so that nothing is left over.
    assert abs(last_turn(piled.fx)) < FOUND
    effect = KNOWN["bulldozing"](force=5.0)
    memory = effect.begin(jnp.zeros(2))
    back = [float(effect.load(jnp.array([x, 0.0]), jnp.zeros(2), _moment(), memory)[0])
            for x in (0.1, -0.1)]  # fmt: skip
    assert back[0] == -back[1] < 0


def _motion():
    """Two plates 20 and 40 mm deep, at 0.1 and 0.3 m/s."""
    still = plate_motion(
        Simulator().wheel.cut().plates(jnp.zeros(())),
        jnp.asarray(0.1),
        jnp.zeros(2),
        jnp.zeros(()),
        jnp.zeros(()),
        REST_SPEED,
        jnp.asarray(0.15),
    )
    nought = jnp.zeros(2)
    return replace(
        still,
        depth=jnp.array([0.02, 0.04]),
        velocity_x=jnp.array([0.1, 0.0]),
        velocity_z=jnp.array([0.0, -0.3]),
        **dict.fromkeys(("direction_x", "direction_z", "normal_speed", "share"), nought),
    )


@pytest.mark.parametrize(
    ("effect", "factor"),
    [
        (RateHardening(excess=0.1, half=0.1), [1.05, 1.075]),
        (DepthHardening(excess=0.1), [1.0, 1.1]),
        (KNOWN["rigid_floor"](excess=0.5, floor=0.03), [1.0, 1.25]),
        (KNOWN["cohesion"](depth=0.002), [1.1, 1.05]),
    ],
)
def test_factors_of_stress_by_hand(effect, factor):
    np.testing.assert_allclose(effect.factor(_motion()), factor, rtol=CLOSE)


@pytest.mark.parametrize(
    ("name", "shapes"),
    [("rate_hardening", {}), ("cohesion", {}), ("rigid_floor", {"floor": 0.005})],
)
def test_stiffer_sand_carries_the_wheel_higher(name, shapes):
    # By a millimetre or more, of 40.
    assert last_turn(held(name, **shapes).z) > last_turn(hold().z) + 1e-3


def test_cohesion_adds_the_same_stress_at_every_depth():
    effect, depth = KNOWN["cohesion"](depth=0.002), np.array([0.003, 0.01, 0.05])
    factor = effect.factor(replace(_motion(), depth=jnp.asarray(depth)))
    np.testing.assert_allclose(depth * (factor - 1), 0.002, rtol=ROUNDING)


def test_momentum_flux_and_height_decrease_are_numbers_of_the_law():
    for effect, law in (
        (MomentumFlux(excess=0.4), Dynamic(inertial_coefficient=1.5)),
        (HeightDecrease(excess=-1.0), Dynamic(height_decrease=0.0)),
    ):
        changed = effect.adjust(Simulator())
        true = Simulator(terrain=Terrain(law=law))
        pairs = zip(jax.tree.leaves(changed), jax.tree.leaves(true), strict=True)
        assert all(np.allclose(a, b, rtol=ROUNDING, atol=0) for a, b in pairs)


def test_a_long_wave_of_the_surface_lifts_the_wheel_as_it_rises():
    length, amplitude = 2.0, 0.001
    output = ran(True, surface_profile={"cosine": 0.0, "sine": amplitude, "length": length})
    wave = amplitude * np.sin(2 * np.pi * output.x / length)
    np.testing.assert_allclose(output.z - hold().z, wave, rtol=0, atol=WAVE * amplitude)


def test_a_wave_is_a_plane_under_the_wheel_that_touches_it_there():
    effect = KNOWN["surface_profile"](cosine=0.002, sine=0.001, length=0.37)

    def wave(x: float) -> float:
        phase = 2 * np.pi * x / 0.37
        return 0.002 * (np.cos(phase) - 1) + 0.001 * np.sin(phase)

    for axle in (-0.4, 0.0, 0.11, 1.3):
        ahead = jnp.array([-0.08, 0.0, 0.05])
        slope = (wave(axle + 1e-6) - wave(axle - 1e-6)) / 2e-6
        expected = wave(axle) + slope * np.asarray(ahead)
        np.testing.assert_allclose(effect.height(axle, ahead, ()), expected, rtol=0, atol=QUOTIENT)


def test_a_slope_tilts_the_way():
    rise = held("surface_slope").z - hold().z
    near(np.polyfit(hold().x, rise, 1)[0], size("surface_slope"))


def test_excavation_lowers_the_wheel_by_its_slip():
    output = held("excavation")
    slipped = RADIUS * (output.angle[-1] - output.angle[0]) - advance(output)
    near(hold().z[-1] - output.z[-1], size("excavation") * slipped, 0.1)


# Rig


def balance(output, axis: str, mass: float) -> float:
    """Mean force [N] on the axle over the run but the sand's, from its momentum."""
    force, speed = getattr(output, f"f{axis}")[1:], getattr(output, f"v{axis}")
    inertia = mass * (speed[-1] - speed[0]) / output.time[-1]
    return float(inertia - np.mean(force))


def test_vertical_load_is_a_heavier_wheel():
    output = held("vertical_load")
    near(-balance(output, "z", 18.837), WEIGHT + size("vertical_load"), SAMPLED)
    heavy = replace(simulator(RIM), effects=())
    heavy = replace(
        heavy, rig=replace(heavy.rig, mass_z=heavy.rig.mass_z + size("vertical_load") / 9.81)
    )
    z = jax.jit(lambda: rows(heavy, start(True), HOLD, DT, EVERY).z)()
    assert last_turn(output.z) == pytest.approx(last_turn(z), abs=REACHED)


def test_vertical_spring_takes_its_share_of_the_weight():
    output = held("vertical_spring")
    sunk = last_turn(output.sinkage) - float(output.sinkage[0])
    carried = WEIGHT - size("vertical_spring") * sunk
    assert last_turn(output.fz) == pytest.approx(carried, abs=FOUND)


@pytest.mark.parametrize("name", ["vertical_coulomb", "vertical_viscous"])
def test_friction_of_the_guide_keeps_a_dropped_wheel_up_longer(name):
    above = replace(start(False), position=jnp.array([0.0, -0.005]))
    still = np.zeros(STEPS)
    values = vector(**{name: {field: 10 * v for field, v in typical(name).items()}})
    slow = program()(jnp.asarray(values), above, still)
    free = program()(jnp.asarray(vector()), above, still)
    assert np.all(slow.z[1:] > free.z[1:])
    # It has left where it was dropped from, 5 mm under the surface.
    assert free.z[5] < -0.006


def test_friction_at_rest_does_not_shake_the_wheel():
    values = vector(vertical_coulomb={"force": 50.0}, horizontal_coulomb={"force": 30.0})
    output = program()(jnp.asarray(values), start(False), np.zeros(STEPS))
    # It stands, but for a creep of a few widths at rest: under 0.25 mm a minute.
    assert np.abs(output.vz[5:]).max() < 6 * REST_SPEED
    assert np.abs(output.vx[5:]).max() < 6 * REST_SPEED


@pytest.mark.parametrize(
    ("name", "pull"),
    [
        ("drawbar", lambda v: size("drawbar")),
        ("horizontal_coulomb", lambda v: size("horizontal_coulomb")),
        ("horizontal_viscous", lambda v: size("horizontal_viscous") * v),
    ],
)
def test_the_sand_pushes_as_hard_as_the_carriage_is_held(name, pull):
    output = held(name)
    near(-balance(output, "x", 13.902), pull(np.mean(output.vx[1:])), SAMPLED)
    assert advance(output) < advance(hold())


def test_a_cable_pulls_the_harder_the_farther_it_is_drawn():
    output = held("cable_spring")
    half = len(output.x) // 2
    stiffness = np.polyfit((output.x - output.x[0])[half:], output.fx[half:], 1)[0]
    near(stiffness, size("cable_spring"))


# Sensors


def test_scales_read_their_ratio_and_drift():
    plain, drift = hold(), held("sinkage_drift")
    np.testing.assert_allclose(
        drift.z - plain.z, size("sinkage_drift") * plain.time, rtol=0, atol=ROUNDING
    )
    travel = held("travel_gain")
    np.testing.assert_allclose(travel.x, (1 + size("travel_gain")) * plain.x, rtol=CLOSE)
    np.testing.assert_allclose(travel.vx, plain.vx, rtol=CLOSE)


@pytest.mark.parametrize(("name", "gain"), [("sinkage_gain", 1), ("sinkage_offset", 0)])
def test_the_static_sinkage_was_read_wrongly_too(name, gain):
    ratio, offset, moving = 1 + gain * size(name), (1 - gain) * size(name), start(True)
    x, z = moving.position
    there = replace(moving, position=jnp.array([x, (z - offset) / ratio]))
    truth = jax.tree.map(np.asarray, program()(jnp.asarray(vector()), there, HOLD))
    found = held(name)
    np.testing.assert_allclose(found.z, ratio * truth.z + offset, rtol=CLOSE)
    np.testing.assert_allclose(found.sinkage, -found.z, rtol=ROUNDING)
    np.testing.assert_allclose(found.x, truth.x, rtol=CLOSE)


@pytest.mark.parametrize("name", ["measurement_delay", "measurement_filter"])
def test_late_readings_trail_an_even_motion_by_their_delay(name):
    output = held(name)
    near(hold().x[-1] - output.x[-1], size(name) * hold().vx[-1], CLOSE)
    np.testing.assert_allclose(output.vx, hold().vx, rtol=CLOSE)  # the truth is not touched


def test_a_delay_shifts_where_a_filter_smears():
    """Both trail a ramp alike; of the bend at its start, only the filter makes a slow curve."""
    plain = starting()
    names = ("measurement_delay", "measurement_filter")
    delay, lag = (ran(False, **{name: typical(name)}) for name in names)
    shifted = np.interp(plain.time - 0.1, plain.time, plain.x)
    missed = [np.abs(each.x - shifted).max() for each in (delay, lag)]
    assert missed[0] < 0.3 * missed[1]
