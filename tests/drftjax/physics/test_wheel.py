"""Wheels: what their plates add up to, and that only geometry is left out, never force."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.arrays import as_real
from drftjax.common.errors import InputError
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator

# Sums of some hundred doubles of order one.
ROUNDING = 1e-12
# Plates left out carry nothing, so forces of some 100 N agree but for the order of adding up.
FORCE_ROUNDING = 1e-10
# Turned by 1,200 pitches the angle itself is only known to 1e-13, and force changes by some 1,000 N
# a radian.
PITCH_ROUNDING = 1e-10
# Short sides of grousers are cut into a third as many plates: of some 200 N [N].
CUT_OTHERWISE = 1e-3
# Flat tips for a curved rim, and plates of half a millimetre that lie elsewhere.
FLAT_TIPS = 2e-3
# A rim plate of 4 mm, inclined by 30 degrees or more, is all in the sand this much deeper [m], and
# then carries more than this [N].
DEEPER, MISSED = 4e-3, 0.1

ANGLES = np.linspace(-1.0, 7.0, 33)
FULL = math.pi


def wrench(wheel, sinkage, angle, velocity=(0.05, -0.02), omega=0.6):
    simulator = Simulator(wheel=wheel)
    return simulator.wrench(
        jnp.stack([jnp.zeros(()), -jnp.asarray(sinkage, float)]),
        jnp.asarray(velocity),
        jnp.asarray(angle, float),
        jnp.asarray(omega),
        jnp.asarray(0.7823),
    )


@eqx.filter_jit
def _wrenches(wheel, sinkage, angles):
    return jax.vmap(lambda angle: wrench(wheel, sinkage, angle))(angles)


def wrenches(wheel, sinkage: float, angles: np.ndarray = ANGLES):
    """Force and torque at each of some angles, shape (angles, 3)."""
    return _wrenches(wheel, as_real(sinkage), as_real(angles))


@pytest.mark.parametrize("angle", [0.0, 0.3, 4.0])
def test_normals_are_unit_and_point_outward(angle):
    for wheel in (GrouserWheel(reach=FULL), PlainWheel(reach=FULL)):
        plates = wheel.cut().plates(jnp.asarray(angle))
        length = jnp.hypot(plates.normal_x, plates.normal_z)
        np.testing.assert_allclose(length, 1, rtol=0, atol=ROUNDING)
        assert float(jnp.min(plates.normal_x * plates.x + plates.normal_z * plates.z)) > 0


def test_side_faces_of_a_grouser_look_away_from_its_middle():
    # All plates beyond the rim that are not tips, of the grouser that points straight down.
    plates = GrouserWheel().cut().plates(jnp.zeros(()))
    sides = (jnp.abs(plates.normal_z) < 1e-9) & (jnp.abs(plates.x) < 0.01)
    assert int(jnp.sum(sides)) == 2 * GrouserWheel().side_plates
    np.testing.assert_allclose(
        plates.normal_x[sides], jnp.sign(plates.x[sides]), rtol=0, atol=ROUNDING
    )


def test_lengths_that_differ_by_rounding_are_cut_alike():
    # As imported tables have them: the mean of a column of equal numbers.
    sizes = {"radius": 0.0575, "grouser_height": 0.005, "grouser_thickness": 0.008}
    wheel = GrouserWheel(**sizes, grouser_count=24)
    rounded = GrouserWheel(**{k: v * (1 + 4e-16) for k, v in sizes.items()}, grouser_count=24)
    assert jax.tree.structure(wheel) == jax.tree.structure(rounded)


def test_plates_add_up_to_the_perimeter():
    radius, width, count, height, thickness = 0.15, 0.12, 12, 0.018, 0.009
    rim = 2 * math.pi * radius - count * thickness
    grousers = count * (thickness + 2 * height)
    area = jnp.sum(GrouserWheel(reach=FULL).cut().plates(jnp.zeros(())).area)
    assert float(area) == pytest.approx(width * (rim + grousers), rel=ROUNDING)
    area = jnp.sum(PlainWheel(reach=FULL).cut().plates(jnp.zeros(())).area)
    assert float(area) == pytest.approx(width * 2 * math.pi * radius, rel=ROUNDING)


def test_closed_outline_has_no_net_normal():
    # The flux of a constant through a closed surface is nothing.
    for wheel in (GrouserWheel(reach=FULL), PlainWheel(reach=FULL)):
        plates = wheel.cut().plates(jnp.asarray(0.7))
        for normal in (plates.normal_x, plates.normal_z):
            assert float(jnp.sum(normal * plates.area)) == pytest.approx(0, abs=ROUNDING)


def test_wheel_that_turns_forward_moves_its_lowest_point_backward():
    still = GrouserWheel().cut().plates(jnp.zeros(()))
    turned = GrouserWheel().cut().plates(jnp.asarray(0.01))
    lowest = int(jnp.argmin(still.z))
    assert float(turned.x[lowest]) < float(still.x[lowest])


@pytest.mark.parametrize("make", [GrouserWheel, PlainWheel])
@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_plates_near_the_sand_carry_all_that_the_whole_circle_carries(make, share):
    near, whole = make(), make(reach=FULL)
    sinkage = share * float(near.cut().sinkage_limit)
    some = wrenches(near, sinkage)
    all_round = wrenches(whole, sinkage)
    np.testing.assert_allclose(some, all_round, rtol=0, atol=FORCE_ROUNDING)
    assert float(jnp.min(all_round[:, 1])) > 1


def test_sinkage_limit_is_where_the_next_plate_would_touch():
    # One pitch short of half a turn every plate of the circle that can touch must be carried.
    near = GrouserWheel(reach=0.8)
    limit = float(near.cut().sinkage_limit)
    assert limit < float(GrouserWheel().cut().sinkage_limit)
    some = wrenches(near, limit)
    whole = wrenches(GrouserWheel(reach=FULL), limit)
    np.testing.assert_allclose(some, whole, rtol=0, atol=FORCE_ROUNDING)


@pytest.mark.parametrize("reach", [0.5, math.pi / 3])
def test_past_the_sinkage_limit_a_plate_is_missing(reach):
    near = GrouserWheel(reach=reach)
    deeper = float(near.cut().sinkage_limit) + DEEPER
    half_a_pitch_off = np.linspace(0.4, 0.6, 41) * 2 * math.pi / 12
    some = wrenches(near, deeper, half_a_pitch_off)
    whole = wrenches(GrouserWheel(reach=FULL), deeper, half_a_pitch_off)
    assert np.abs(some - whole).max() > MISSED


@pytest.mark.parametrize("count", [1, 2, 3])
def test_wheel_that_carries_all_its_grousers_may_sink_to_its_axle(count):
    wheel = GrouserWheel(grouser_count=count)
    assert float(wheel.cut().sinkage_limit) == pytest.approx(float(wheel.radius), abs=ROUNDING)


@pytest.mark.parametrize("turns", [1, -1, 5, 12, 1200])
def test_turning_by_whole_pitches_changes_nothing(turns):
    pitch = 2 * math.pi / 12
    before = wrench(GrouserWheel(), 0.03, 0.1)
    after = wrench(GrouserWheel(), 0.03, 0.1 + turns * pitch)
    np.testing.assert_allclose(after, before, rtol=0, atol=PITCH_ROUNDING)


def test_plain_wheel_is_the_same_at_every_angle():
    at_angles = wrenches(PlainWheel(), 0.03)
    expected = jnp.broadcast_to(at_angles[0], at_angles.shape)
    np.testing.assert_array_equal(at_angles, expected)


def test_grouser_fraction_shortens_the_grousers():
    # A third of the height by its fraction, or cut so: the same outline.
    third = GrouserWheel(grouser_fraction=1 / 3)
    short = GrouserWheel(grouser_height=0.006)
    np.testing.assert_allclose(
        wrench(third, 0.03, 0.2), wrench(short, 0.03, 0.2), rtol=0, atol=CUT_OTHERWISE
    )
    deepest = [
        float(-jnp.min(GrouserWheel(grouser_fraction=f).cut().plates(jnp.zeros(())).z))
        for f in (0.0, 1 / 3, 1.0)
    ]
    np.testing.assert_allclose(deepest, [0.150, 0.156, 0.168], rtol=0, atol=ROUNDING)


def test_grousers_of_no_height_leave_the_rim():
    bare = GrouserWheel(grouser_fraction=0.0, plate_size=0.0005)
    rim = PlainWheel(plate_size=0.0005)
    np.testing.assert_allclose(wrench(bare, 0.03, 0.2), wrench(rim, 0.03, 0.2), rtol=FLAT_TIPS)


@pytest.mark.parametrize("make", [GrouserWheel, PlainWheel])
@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"radius": 150.0}, "metres"),
        ({"radius": 150}, "metres"),
        ({"width": 120.0}, "metres"),
        ({"radius": math.nan}, "radius"),
        ({"radius": -0.15}, "radius"),
        ({"plate_size": 0.0}, "plate size"),
        ({"plate_size": 4.0}, "plate size"),
        ({"reach": 90.0}, "reach"),
    ],
)
def test_slip_of_units_is_refused(make, wrong, reason):
    with pytest.raises(InputError, match=reason):
        make(**wrong)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"grouser_height": 18.0}, "metres"),
        ({"grouser_thickness": 9.0}, "pitch"),
        ({"grouser_thickness": 0.09}, "pitch"),
        ({"grouser_count": 0}, "PlainWheel"),
        ({"grouser_fraction": -0.1}, "fraction"),
        ({"grouser_height": math.inf}, "height"),
    ],
)
def test_grousers_that_cannot_be_are_refused(wrong, reason):
    with pytest.raises(InputError, match=reason):
        GrouserWheel(**wrong)
