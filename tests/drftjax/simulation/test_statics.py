"""Statics: what zeta carries the test bed's wheel at its sinkage, and back again."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.rig import (
    Drawbar,
    SurfaceSpring,
    VerticalCoulomb,
    VerticalLoad,
    VerticalSpring,
)
from drftjax.physics.wheel import GrouserWheel, PlainWheel
from drftjax.simulation.simulator import Simulator
from drftjax.simulation.statics import (
    INTRUSION,
    REST,
    StaticsSettings,
    sinkage_under_load,
    vertical_support,
    zeta_from_sinkage,
)

# Sinkage and zeta of Table 3 of Fuke et al. 2024, and the load of its Table 1 [N].
SINKAGE, TABLE_3, LOAD = 0.0176, 0.7823, 18.837 * 9.81

# Ranges given with two or three digits, and the plates' part of it.
LAST_DIGIT = 0.006
# Where the root is known to a nanometre, zeta is known to 1e-9 / 0.02; twice that.
ROUND_TRIP = 1e-7
# Central differences with relative steps of 1e-5 err by the square of that, times a bend of tens.
DERIVATIVE = 3e-9
# Relative steps of 1e-3 move the root by 26 um, of which its nanometre at either end is 4e-5.
DERIVATIVE_OF_ROOT = 1e-4
# What the plates of a wheel that sinks at INTRUSION throw aside, whatever zeta is [N].
MOMENTUM = 5e-3

# Over one pitch. Straight up, both side faces of the grouser slide along the sand: a case apart.
TURNED = np.radians(np.linspace(0.5, 29.5, 30))


def with_fraction(fraction):
    return Simulator(wheel=GrouserWheel(grouser_fraction=fraction))


def zetas(simulator, angles=TURNED):
    at = jax.vmap(lambda angle: zeta_from_sinkage(simulator, SINKAGE, angle=angle))
    return jax.jit(at)(angles)


@pytest.mark.parametrize(
    ("simulator", "low", "high"),
    [
        (with_fraction(1.0), 0.72, 0.74),
        (with_fraction(1 / 3), 0.865, 0.882),
        (Simulator(wheel=PlainWheel()), 0.935, 0.935),
    ],
    ids=["full", "third", "bare"],
)
def test_zeta_of_table_3_lies_between_full_grousers_and_a_bare_rim(simulator, low, high):
    over_angle = zetas(simulator)
    assert float(jnp.min(over_angle)) > low - LAST_DIGIT
    assert float(jnp.max(over_angle)) < high + LAST_DIGIT


@pytest.mark.parametrize(
    ("fraction", "expected"),
    [(1.0, 0.74), (0.8, 0.780), (1 / 3, 0.882)],
    ids=["full", "0.8", "third"],
)
def test_zeta_of_a_wheel_that_stands_on_one_grouser_counts_leading_plates_only(fraction, expected):
    # The support by plates that strictly lead; 0.8 of the height comes nearest to Table 3.
    load = with_fraction(fraction).plate_load(
        jnp.array([0.0, -SINKAGE]),
        jnp.array([0.0, -INTRUSION]),
        jnp.zeros(()),
        jnp.zeros(()),
        jnp.ones(()),
    )
    leading = load.motion.normal_speed > 1e-9
    support = jnp.sum(jnp.where(leading, load.stress_z * load.plates.area, 0))
    assert LOAD / float(support) == pytest.approx(expected, abs=LAST_DIGIT)


def test_side_faces_that_slide_along_the_sand_add_to_the_support():
    # n.p = 0 exactly: they carry as a wheel at rest does, and zeta is 3 % lower at this angle.
    upright = float(zeta_from_sinkage(Simulator(), SINKAGE))
    beside = float(zeta_from_sinkage(Simulator(), SINKAGE, angle=math.radians(1.0)))
    assert upright / beside == pytest.approx(0.97, abs=LAST_DIGIT)


def test_table_3_follows_from_four_fifths_of_the_grouser_height_within_3_percent():
    assert float(jnp.mean(zetas(with_fraction(0.8)))) == pytest.approx(TABLE_3, rel=0.03)


@pytest.mark.parametrize("descent", [INTRUSION, REST])
@pytest.mark.parametrize("wheel", [GrouserWheel(), PlainWheel()], ids=["grousers", "plain"])
def test_sinkage_gives_back_the_zeta_it_came_from(wheel, descent):
    simulator = Simulator(wheel=wheel)
    for zeta in (0.5, TABLE_3, 1.5):
        sinkage = sinkage_under_load(simulator, zeta, angle=0.1, descent=descent)
        back = zeta_from_sinkage(simulator, sinkage, angle=0.1, descent=descent)
        assert float(back) == pytest.approx(zeta, rel=ROUND_TRIP)
        support = vertical_support(simulator, sinkage, zeta, 0.1, descent)
        assert float(support) == pytest.approx(LOAD, rel=ROUND_TRIP)


def test_load_other_than_the_weight_is_carried():
    sinkage = sinkage_under_load(Simulator(), TABLE_3, load=100.0)
    support = float(vertical_support(Simulator(), sinkage, TABLE_3))
    assert support == pytest.approx(100.0, rel=ROUND_TRIP)
    assert float(zeta_from_sinkage(Simulator(), sinkage, load=100.0)) == pytest.approx(TABLE_3)


def test_wheel_at_rest_must_be_deeper_than_one_that_sinks():
    # The sand at rest carries 42 % of the weight at 17.6 mm, all of it at 33.7 mm: to half a unit
    # of the last digit.
    resting = vertical_support(Simulator(), SINKAGE, TABLE_3, descent=REST)
    assert float(resting) / LOAD == pytest.approx(0.42, abs=0.005)
    depth = sinkage_under_load(Simulator(), TABLE_3, descent=REST)
    assert float(depth) == pytest.approx(33.7e-3, abs=0.05e-3)


def test_support_is_proportional_to_zeta_and_grows_with_depth():
    one = float(vertical_support(Simulator(), SINKAGE, 1.0))
    assert float(vertical_support(Simulator(), SINKAGE, 2.0)) == pytest.approx(
        2 * one, abs=MOMENTUM
    )
    depths = jnp.linspace(0.0, 0.1, 50)
    support = jax.jit(jax.vmap(lambda depth: vertical_support(Simulator(), depth, 1.0)))(depths)
    assert bool(jnp.all(jnp.diff(support) > 0))


def central(function, at, relative=1e-5):
    return (function(at * (1 + relative)) - function(at * (1 - relative))) / (2 * relative * at)


def test_derivatives_of_zeta_are_central_differences():
    def by_sinkage(sinkage):
        return zeta_from_sinkage(Simulator(), sinkage, angle=0.1)

    def by_mass(mass):
        rig = dataclasses.replace(Simulator().rig, mass_z=mass)
        return zeta_from_sinkage(Simulator(rig=rig), SINKAGE, angle=0.1)

    def by_radius(radius):
        wheel = eqx.tree_at(lambda wheel: wheel.radius, GrouserWheel(), radius)
        return zeta_from_sinkage(Simulator(wheel=wheel), SINKAGE, angle=0.1)

    for by, at in ((by_sinkage, SINKAGE), (by_mass, 18.837), (by_radius, 0.150)):
        function, at = jax.jit(by), jnp.asarray(at)
        expected = float(central(function, at))
        assert float(jax.grad(function)(at)) == pytest.approx(expected, rel=DERIVATIVE)
        assert float(jax.jvp(function, (at,), (jnp.ones(()),))[1]) == pytest.approx(
            expected, rel=DERIVATIVE
        )


def test_derivatives_of_sinkage_are_central_differences():
    def by_zeta(zeta):
        return sinkage_under_load(Simulator(), zeta, angle=0.1)

    def by_load(load):
        return sinkage_under_load(Simulator(), TABLE_3, load, 0.1)

    for function, at in ((by_zeta, TABLE_3), (by_load, LOAD)):
        at = jnp.asarray(at)
        # Wide against the root's tolerance of a nanometre.
        expected = float(central(function, at, 1e-3))
        assert float(jax.grad(function)(at)) == pytest.approx(expected, rel=DERIVATIVE_OF_ROOT)
        assert float(jax.jvp(function, (at,), (jnp.ones(()),))[1]) == pytest.approx(
            expected, rel=DERIVATIVE_OF_ROOT
        )
        assert np.sign(expected) == (-1 if function is by_zeta else 1)


@pytest.mark.parametrize("sinkage", [-0.01, 0.0, 0.3, 17.6, math.nan])
def test_sinkage_that_cannot_be_is_refused(sinkage):
    with pytest.raises(InputError, match="sinkage"):
        zeta_from_sinkage(Simulator(), sinkage)


def test_the_settings_decide_how_closely_the_sinkage_is_found():
    fine = float(sinkage_under_load(Simulator(), TABLE_3))
    coarse = StaticsSettings(tolerance=1e-3)
    found = float(sinkage_under_load(Simulator(), TABLE_3, settings=coarse))
    assert 1e-6 < abs(found - fine) < 2e-3


def test_another_load_or_zeta_compiles_nothing(compiled):
    # A speed that no other test compiles for.
    first = float(sinkage_under_load(Simulator(), 0.75, 150.0, descent=0.012))
    assert compiled
    compiled.clear()
    assert float(sinkage_under_load(Simulator(), 0.8, 180.0, descent=0.012)) != first
    assert not compiled


@pytest.mark.parametrize(
    ("effect", "pressed"),
    [
        (VerticalLoad(force=30.0), 30.0),
        (VerticalLoad(force=-30.0), -30.0),
        # It counts from where the wheel stands.
        (VerticalSpring(stiffness=800.0), 0.0),
        # It counts from the undisturbed surface.
        (SurfaceSpring(stiffness=800.0), -800.0 * SINKAGE),
        (Drawbar(force=30.0), 0.0),
        (VerticalCoulomb(force=30.0), 0.0),
    ],
)
def test_what_presses_the_wheel_at_rest_is_borne(effect, pressed):
    simulator = Simulator(effects=(effect,))
    weight = float(simulator.rig.mass_z * simulator.rig.gravity)
    zeta = float(zeta_from_sinkage(simulator, SINKAGE))
    plain = float(zeta_from_sinkage(Simulator(), SINKAGE))
    assert zeta / plain == pytest.approx(1 + pressed / weight, abs=2 * MOMENTUM / LOAD)
    assert float(sinkage_under_load(simulator, zeta)) == pytest.approx(SINKAGE, rel=ROUND_TRIP)
