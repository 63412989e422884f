"""Wheels given as points: they carry what the built-in ones carry, and slips are refused."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.outline_wheel import OutlineWheel, read_outline
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator

# Half a millimetre of plate: the same outline cut at other places differs by 0.1 to 0.3 %.
PLATES = 5e-4
PLATE_ACCURACY = 5e-3
# Sums of some hundred doubles of order one.
ROUNDING = 1e-12
# Twelve grousers of thickness t stand on a rim that curves by t^3 / 12 r under each: 3e-5 to 7e-5.
FEET = 1e-4
# Central differences over 1e-6 of the size round forces of 40 N to 1e-8 N, of a slope of 1,300 N.
DIFFERENCES = 1e-9

RADIUS = 0.150


def circle(count=720, radius=RADIUS):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def grousered(count=12, height=0.018, thickness=0.009, step=5e-4):
    """Corners of the paper's wheel, counter-clockwise, the rim as a fine polygon."""
    pitch, half = 2 * np.pi / count, thickness / 2
    start = math.asin(half / RADIUS)
    steps = math.ceil((pitch - 2 * start) * RADIUS / step)
    corners = []
    for k in range(count):
        # In the frame of a grouser that points along +x: tip corners, then the rim to the next.
        tip = np.array([[RADIUS + height, -half], [RADIUS + height, half]])
        rim = start + (pitch - 2 * start) * np.arange(steps + 1) / steps
        sector = np.concatenate([tip, RADIUS * np.stack([np.cos(rim), np.sin(rim)], axis=1)])
        # Grousers of the built-in wheel point straight down at angle zero.
        angle = k * pitch - np.pi / 2
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        corners.append(sector @ turned.T)
    return np.concatenate(corners)


def wrenches(wheel, sinkage, angles, omega=0.6):
    return _wrenches(wheel, *(jnp.asarray(each, float) for each in (sinkage, angles, omega)))


@eqx.filter_jit
def _wrenches(wheel, sinkage, angles, omega):
    simulator = Simulator(wheel=wheel).prepared()
    place, velocity = jnp.stack([jnp.zeros(()), -sinkage]), jnp.array([0.05, -0.02])

    def at(angle):
        return simulator.wrench(place, velocity, angle, omega, jnp.asarray(0.7823))

    return jax.vmap(at)(angles)


def assert_same(got, expected, share):
    """Componentwise, as a share of the largest component over all angles."""
    scale = np.max(np.abs(expected), axis=0)
    assert np.max(np.abs(got - expected) / scale) < share


@pytest.mark.parametrize("count", [1, 2, 12])
@pytest.mark.parametrize("sinkage", [0.01, 0.03, 0.06])
def test_polygon_of_the_grousered_outline_carries_what_the_grouser_wheel_carries(sinkage, count):
    angles = np.linspace(0, 2 * np.pi, 25)
    built_in = GrouserWheel(grouser_count=count, plate_size=PLATES)
    assert float(built_in.cut().sinkage_limit) > sinkage
    drawn = wrenches(OutlineWheel(grousered(count), RADIUS, plate_size=PLATES), sinkage, angles)
    built = wrenches(built_in, sinkage, angles)
    assert_same(np.asarray(drawn), np.asarray(built), PLATE_ACCURACY)


@pytest.mark.parametrize("sinkage", [0.01, 0.03, 0.06])
def test_fine_regular_polygon_carries_what_the_plain_wheel_carries(sinkage):
    angles = np.linspace(0, 1, 7)
    polygon = wrenches(OutlineWheel(circle(2000), RADIUS, plate_size=PLATES), sinkage, angles)
    rim = wrenches(PlainWheel(plate_size=PLATES), sinkage, angles)
    assert_same(np.asarray(polygon), np.asarray(rim), PLATE_ACCURACY)


def test_outline_keeps_its_perimeter_and_its_normals_point_outward():
    corners = grousered()
    plates = OutlineWheel(corners, RADIUS, 0.12).cut().plates(jnp.zeros(()))
    perimeter = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).sum()
    assert float(jnp.sum(plates.area)) == pytest.approx(0.12 * perimeter, rel=ROUNDING)
    np.testing.assert_allclose(
        jnp.hypot(plates.normal_x, plates.normal_z), 1, rtol=0, atol=ROUNDING
    )
    # The divergence theorem: half the flux of the place through the outline is its area.
    area = 0.5 * jnp.sum((plates.normal_x * plates.x + plates.normal_z * plates.z) * plates.area)
    rim, grousers = np.pi * RADIUS**2, 12 * 0.018 * 0.009
    assert float(area) / 0.12 == pytest.approx(rim + grousers, rel=FEET)


def test_rounding_of_an_edge_makes_no_plate_more():
    """Or wheels written by two programs would not go into one batch."""
    corner = 0.1
    for side in (corner, corner * (1 + 1e-15), corner * (1 - 1e-15)):
        square = [(-side, -side), (side, -side), (side, side), (-side, side)]
        assert OutlineWheel(square, 0.1, plate_size=4e-3).edge_plates == (50,) * 4


def test_outline_is_differentiable_by_its_points():
    points = jnp.asarray(circle(60))

    def lift(scale):
        wheel = OutlineWheel(np.asarray(points), RADIUS)
        wheel = eqx.tree_at(lambda w: w.points, wheel, scale * points)
        return wrenches(wheel, 0.03, jnp.zeros(1))[0, 1]

    slope = jax.grad(lift)(1.0)
    central = (lift(1 + 1e-6) - lift(1 - 1e-6)) / 2e-6
    assert float(slope) == pytest.approx(float(central), rel=DIFFERENCES)
    assert float(slope) > 0


SQUARE = np.array([[0.1, -0.1], [0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1]])


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (SQUARE[::-1], "clockwise"),
        (SQUARE[[0, 2, 1, 3]], "crosses itself"),
        (1000 * SQUARE, "metres"),
        (SQUARE + np.array([0.5, 0.0]), "axle"),
        (SQUARE[:2], "three or more points"),
        (SQUARE[:, :1], "three or more points"),
        (np.where(SQUARE[2] == SQUARE, np.nan, SQUARE), "not finite"),
        (SQUARE[[0, 1, 1, 2, 3]], "the same"),
        (0.01 * SQUARE, "metres"),
    ],
)
def test_outline_that_is_no_wheel_is_refused(points, reason):
    with pytest.raises(InputError, match=reason):
        OutlineWheel(points, 0.1)


def test_radius_that_does_not_go_with_the_outline_is_refused():
    with pytest.raises(InputError, match="reach of its outline"):
        OutlineWheel(circle(), 0.3)
    with pytest.raises(InputError, match="metres"):
        OutlineWheel(circle(), 150)


def write(folder, lines):
    path = folder / "outline.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def lines_of(corners):
    return [f"{float(x)!r},{float(z)!r}" for x, z in corners]


def closed(corners):
    return np.concatenate([corners, corners[:1]])


def test_outline_from_a_file_is_the_outline_from_points(tmp_path):
    path = write(tmp_path, ["x,z", *lines_of(closed(circle(36)))])
    np.testing.assert_array_equal(read_outline(path), circle(36))
    wheel = OutlineWheel.from_csv(path, RADIUS)
    np.testing.assert_array_equal(wheel.points, OutlineWheel(circle(36), RADIUS).points)


def test_a_device_is_no_outline():
    with pytest.raises(InputError, match="/dev/zero: is a device"):
        read_outline("/dev/zero")


def test_byte_order_mark_of_an_editor_is_no_obstacle(tmp_path):
    first, *others = lines_of(closed(circle(36)))
    np.testing.assert_array_equal(
        read_outline(write(tmp_path, ["\ufeff" + first, *others])), circle(36)
    )


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        (lines_of(circle(36)), "open"),
        (lines_of(closed(SQUARE)[::-1]), "clockwise"),
        (lines_of(closed(SQUARE[[0, 2, 1, 3]])), "crosses itself"),
        (lines_of(closed(1000 * SQUARE)), "metres"),
        ([*lines_of(SQUARE), "north,0.1", *lines_of(SQUARE[:1])], "line 5.*two numbers"),
        ([*lines_of(SQUARE), "0.1", *lines_of(SQUARE[:1])], "line 5.*two numbers"),
        (["nan,nan", *lines_of(closed(SQUARE))], "open|not finite"),
        (["x,z"], "open"),
        ([], "open"),
    ],
)
def test_file_that_is_no_outline_is_refused_by_name(tmp_path, lines, reason):
    path = write(tmp_path, lines)
    with pytest.raises(InputError, match=reason) as refusal:
        OutlineWheel.from_csv(path, 0.1)
    assert str(path) in str(refusal.value)


def test_missing_and_binary_files_are_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        OutlineWheel.from_csv(tmp_path / "nowhere.csv", 0.1)
    with pytest.raises(InputError, match="cannot be the name of a file"):
        OutlineWheel.from_csv("a\0.csv", 0.1)
    path = tmp_path / "wheel.csv"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"wheel\.csv"):
        OutlineWheel.from_csv(path, 0.1)
