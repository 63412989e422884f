"""The stress law: its anchors, its symmetry, its sources, and the wrench it adds up to."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.stress import (
    ArcBisector,
    Dynamic,
    QuasiStatic,
    Rounded,
    Sharp,
    StressCoefficients,
    plate_motion,
)
from drftjax.physics.terrain import Terrain
from drftjax.physics.wheel import GrouserWheel, PlainWheel, Plates
from drftjax.simulation.simulator import Simulator

# Anchors are given with three or four digits.
ANCHOR = 1e-4
# Sums of a few doubles of order one.
ROUNDING = 1e-12
# Wrenches of some 100 N, added up in another order.
FORCE_ROUNDING = 1e-9
# The share of direction that the regulariser takes at 0.04 m/s is 3e-6; twice that of two of them,
# and what a force given with four digits is rounded by.
PLATE_DRAG = 2e-5
# Of the stress of poppy seeds, what no scaled generic law covers.
POPPY_SEEDS = 0.2
# Half a unit of the last digit of a height decrease in hundredths of a millimetre.
LAST_DIGIT = 0.005e-3
# Of the wrench, what corners a hundredth as wide as the search's are off by.
WIDTHS = 1e-4
# Trapezoids of 0.25 mm over what bends within 2 mm.
TRAPEZOIDS = 1e-3

GENERIC = {
    "A00": 0.206,
    "A10": 0.169,
    "B11": 0.212,
    "B01": 0.358,
    "B-11": 0.055,
    "C11": -0.124,
    "C01": 0.253,
    "C-11": 0.007,
    "D10": 0.088,
}
LOOSE_VALUES = (0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.0, 0.025)
CLOSE_VALUES = (0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046)
LOOSE = dict(zip(GENERIC, LOOSE_VALUES, strict=True))
CLOSE = dict(zip(GENERIC, CLOSE_VALUES, strict=True))


def alpha(coefficients, beta, gamma):
    """alpha_x, alpha_z from the angles: a plate at attack angle beta has this outward normal."""
    beta, gamma = jnp.asarray(beta, float), jnp.asarray(gamma, float)
    return coefficients(jnp.sin(beta), -jnp.cos(beta), jnp.cos(gamma), -jnp.sin(gamma))


def fourier_sum(named, beta, gamma):
    """The sum of Li et al. 2013, with m in beta / pi and n in gamma / 2 pi, term by term."""
    alpha_x, alpha_z = 0.0, 0.0
    for name, value in named.items():
        kind, orders = name[0], name[1:]
        m, n = (-1, 1) if orders == "-11" else (int(orders[0]), int(orders[1]))
        phase = 2 * np.pi * (m * beta / np.pi + n * gamma / (2 * np.pi))
        term = value * (np.cos(phase) if kind in "AC" else np.sin(phase))
        if kind in "AB":
            alpha_z = alpha_z + term
        else:
            alpha_x = alpha_x + term
    return alpha_x, alpha_z


@pytest.mark.parametrize(
    ("beta", "gamma", "expected"),
    [
        (0, 90, (0.0, 1.000)),
        (90, 0, (0.370, 0.037)),
        (0, 0, (0.136, 0.375)),
        (45, 45, (0.3595, 0.5702)),
        (-45, 45, (-0.0017, 0.3481)),
        (30, 60, (0.2717, 0.7841)),
    ],
)
def test_stress_per_depth_meets_its_anchors(beta, gamma, expected):
    got = alpha(StressCoefficients.generic(), np.radians(beta), np.radians(gamma))
    np.testing.assert_allclose(got, expected, rtol=0, atol=ANCHOR)


def test_mirror_image_turns_the_horizontal_stress_around():
    random = np.random.default_rng(1)
    beta = random.uniform(-np.pi / 2, np.pi / 2, 500)
    gamma = random.uniform(-np.pi, np.pi, 500)
    x, z = alpha(StressCoefficients.generic(), beta, gamma)
    mirrored_x, mirrored_z = alpha(StressCoefficients.generic(), -beta, np.pi - gamma)
    np.testing.assert_allclose(mirrored_x, -x, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(mirrored_z, z, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("coefficients", "named"),
    [
        (StressCoefficients.generic(), GENERIC),
        (StressCoefficients.loose_poppy_seeds(), LOOSE),
        (StressCoefficients.close_poppy_seeds(), CLOSE),
    ],
    ids=["generic", "loose", "close"],
)
def test_law_without_angles_is_the_fourier_sum_over_angles(coefficients, named):
    # Normals and velocities at random; the angles by arctan2, as the papers define them.
    random = np.random.default_rng(2)
    normal, velocity = random.normal(size=(2, 2, 500))
    normal, velocity = normal / np.hypot(*normal), velocity / np.hypot(*velocity)
    beta = np.arctan2(normal[0], -normal[1])
    gamma = np.arctan2(-velocity[1], velocity[0])
    got = coefficients(*map(jnp.asarray, (*normal, *velocity)))
    np.testing.assert_allclose(got, fourier_sum(named, beta, gamma), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    "coefficients",
    [StressCoefficients.loose_poppy_seeds(), StressCoefficients.close_poppy_seeds()],
    ids=["loose", "close"],
)
def test_poppy_seeds_are_nearly_the_generic_law_scaled(coefficients):
    # Li et al. find that one factor carries the generic law over to a medium. Two coefficients
    # in each other's place would leave much more than this.
    beta, gamma = np.meshgrid(np.linspace(-1.5, 1.5, 31), np.linspace(-1.5, 1.5, 31))
    generic = np.stack(alpha(StressCoefficients.generic(), beta, gamma))
    poppy = np.stack(alpha(coefficients, beta, gamma))
    zeta = np.sum(generic * poppy) / np.sum(generic**2)
    assert np.linalg.norm(poppy - zeta * generic) < POPPY_SEEDS * np.linalg.norm(poppy)


# Width at rest [m/s]: far under the speeds of the plates here.
REST_SPEED = 1e-6


def dragged_plate(speed, depth):
    """Horizontal resistance [N] of Agarwal's plane-strain plate, 1 m wide out of the plane.

    zeta stands for K: the generic law resists a vertical plate that is dragged along by 0.370
    N/cm3, so K |z| = zeta 0.370e6 |z| A with A = 0.016 m2 asks for zeta = 0.0980.
    """
    length, parts = 0.016, 8
    zeta = 580.0 / (0.370e6 * length)
    along = jnp.arange(0.5, parts) / parts * length - length / 2
    flat = jnp.ones(parts)
    plates = Plates(0 * flat, along, flat, 0 * flat, length / parts * flat)
    velocity = jnp.stack([speed, jnp.zeros(())])
    nought = jnp.zeros(())
    motion = plate_motion(plates, -depth, velocity, nought, nought, REST_SPEED, nought + 0.15)
    law = Dynamic(inertial_coefficient=1.1, bulk_density=900.0)
    stress_x, _ = law.stress(motion, plates, jnp.asarray(zeta))
    return -jnp.sum(stress_x * plates.area)


def test_dragged_plate_resists_with_depth_and_with_speed_squared():
    # Agarwal et al. 2021: F = K |z| + lambda rho A v^2 over these depths and speeds.
    depths = jnp.array([0.020, 0.030, 0.040])
    speeds = jnp.array([0.04, 0.08, 0.16, 0.32, 0.48, 0.64])
    force = jax.vmap(lambda d: jax.vmap(lambda v: dragged_plate(v, d))(speeds))(depths)
    law = 580.0 * depths[:, None] + 1.1 * 900.0 * 0.016 * speeds**2
    np.testing.assert_allclose(force, law, rtol=PLATE_DRAG)
    for depth, at_depth in zip(depths, force, strict=True):
        slope, static = np.polyfit(np.asarray(speeds) ** 2, np.asarray(at_depth), 1)
        assert slope == pytest.approx(1.1 * 900.0 * 0.016, rel=PLATE_DRAG)
        assert static / float(depth) == pytest.approx(580.0, rel=PLATE_DRAG)


def a_motion():
    """A wheel of the paper in the middle of a drive: (position, velocity, angle, omega, zeta)."""
    return (
        jnp.array([0.3, -0.029]),
        jnp.array([0.071, -0.002]),
        jnp.asarray(1.234),
        jnp.asarray(0.5),
        jnp.asarray(0.7823),
    )


@pytest.mark.parametrize("wheel", [GrouserWheel(), PlainWheel()], ids=["grousers", "plain"])
def test_stress_on_the_plates_sums_to_the_wrench(wheel):
    simulator = Simulator(wheel=wheel)
    load = simulator.plate_load(*a_motion())
    force_x, force_z = load.stress_x * load.plates.area, load.stress_z * load.plates.area
    about_axle = jnp.sum(force_z * load.plates.x - force_x * load.plates.z)
    expected = jnp.stack([jnp.sum(force_x), jnp.sum(force_z), about_axle])
    got = simulator.wrench(*a_motion())
    np.testing.assert_allclose(got, expected, rtol=0, atol=FORCE_ROUNDING)
    assert float(got[1]) > 50


def test_sand_above_the_surface_and_behind_a_plate_carries_nothing():
    load = Simulator().plate_load(*a_motion())
    free = (load.motion.depth < 0) | (load.motion.share == 0)
    # Where a plate moves back faster than the width at rest, by a thousandth of the rim's speed.
    back = load.motion.normal_speed < -2e-3 * 0.15 * 0.5
    assert bool(jnp.all(load.motion.share[back] == 0))
    assert bool(jnp.any(free))
    assert float(jnp.max(jnp.abs(jnp.where(free, load.stress_x, 0)))) == 0
    assert float(jnp.max(jnp.abs(jnp.where(free, load.stress_z, 0)))) == 0


def test_height_decrease_and_momentum_flux_are_what_quasi_static_leaves_out():
    motion = a_motion()
    bare = Dynamic(inertial_coefficient=0.0, height_decrease=0.0)
    without = Simulator(terrain=Terrain(law=bare)).wrench(*motion)
    quasi_static = Simulator(terrain=Terrain(law=QuasiStatic())).wrench(*motion)
    np.testing.assert_allclose(without, quasi_static, rtol=0, atol=FORCE_ROUNDING)


def test_sand_behind_the_axle_is_lower_by_the_height_decrease():
    # delta_h = r (r omega^2 / g): 0.63 mm at 30 deg/s.
    motion = a_motion()
    omega = jnp.radians(jnp.asarray(30.0))
    load = Simulator().plate_load(motion[0], motion[1], motion[2], omega, motion[4])
    assert float(load.motion.height_decrease) == pytest.approx(0.63e-3, abs=LAST_DIGIT)
    # And that is what plates behind it lack of their depth.
    loss = jnp.where(load.plates.x < 0, load.motion.height_decrease, 0.0)
    lowered = dataclasses.replace(load.motion, depth=load.motion.depth - loss)
    whole, level = (
        Dynamic(inertial_coefficient=0.0, height_decrease=share) for share in (1.0, 0.0)
    )
    np.testing.assert_allclose(
        whole.stress(load.motion, load.plates, motion[4]),
        level.stress(lowered, load.plates, motion[4]),
        rtol=ROUNDING,
    )
    assert float(jnp.max(loss)) > 0


def test_the_arc_that_touches_is_halved_between_entry_and_the_lower_sand_behind():
    # Axle 0.12 m over the sand, which is 0.02 m lower behind: the rim of 0.15 m enters it where
    # cos = 0.12 / 0.15 and leaves where cos = 0.14 / 0.15.
    middle = (np.arccos(0.8) - np.arccos(0.14 / 0.15)) / 2
    angle = middle + np.array([-1e-6, 1e-6])
    rim = jnp.asarray(0.15 * np.stack([np.sin(angle), -np.cos(angle)]))
    flat = jnp.ones(2)
    for sense in (1, -1):
        plates = Plates(sense * rim[0], rim[1], flat, flat, flat)
        nought, omega = jnp.zeros(()), jnp.asarray(2.0 * sense)
        still = jnp.zeros(2)
        motion = plate_motion(plates, nought + 0.12, still, omega, nought, 1e-6, nought + 0.15)
        distance = ArcBisector().distance_behind(motion, plates, nought + 0.02)
        np.testing.assert_allclose(distance, [0.15e-6, -0.15e-6], rtol=1e-6)


@pytest.mark.parametrize("law", [Dynamic, QuasiStatic])
def test_rounded_corners_become_sharp_as_their_widths_shrink(law):
    def wrench(corners):
        return np.asarray(Simulator(terrain=Terrain(law=law(corners=corners))).wrench(*a_motion()))

    sharp = wrench(Sharp())
    off = [
        np.abs(wrench(Rounded(share * 2e-3, share * 5e-3, share * 4e-3)) - sharp).max()
        for share in (1.0, 0.1, 0.01)
    ]
    assert off[0] > 3 * off[1] > 9 * off[2]
    assert off[2] < WIDTHS * np.abs(sharp).max()


def test_derivatives_of_rounded_corners_have_slopes():
    def stiffness(corners):
        simulator = Simulator(terrain=Terrain(law=Dynamic(corners=corners)))
        position, *rest = a_motion()
        return jax.jit(jax.grad(lambda z: simulator.wrench(position.at[1].set(z), *rest)[1]))

    # Between these heights plates enter the sand.
    heights = jnp.linspace(-0.034, -0.024, 41)

    def change(corners):
        return float(stiffness(corners)(heights[-1]) - stiffness(corners)(heights[0]))

    def summed(corners):
        slopes = jax.jit(jax.vmap(jax.grad(stiffness(corners))))(heights)
        return float(jnp.trapezoid(slopes, heights))

    assert summed(Rounded()) == pytest.approx(change(Rounded()), rel=TRAPEZOIDS)
    # Sharp ones have none: all change is in their jumps, which no slope adds up to.
    assert abs(summed(Sharp())) < TRAPEZOIDS * abs(change(Sharp()))
