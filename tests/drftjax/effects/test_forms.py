"""Forms of effects, against what another program, another law or a few lines of algebra say."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.effects.base import StepContext
from drftjax.effects.catalogue import field_metadata
from drftjax.physics.rig import Rig
from drftjax.physics.state import State
from drftjax.physics.stress import ArcBisector, Dynamic, QuasiStatic
from drftjax.physics.terrain import Terrain
from drftjax.simulation.simulator import Simulator
from tests.helpers.effect_runs import GROUSERS, KNOWN, RIM, driven, rows, simulator

# Sums and products of some doubles in another order.
CLOSE = 1e-12
# Two programs of the same arithmetic: a search for a root stops at 1e-8 of sqrt(r g) [m].
REACHED = 2e-8
# An implementation that shares no code with this one has 64 and 30 mm, in whole millimetres; coarse
# plates make up for the rest [m].
WHOLE_MILLIMETRES = 1e-3
# The same for forces of some hundred newtons: their slope by a velocity is a mass over a step [N].
FOUND = 1e-3
# A slope from a difference quotient over 1e-5 m errs by that squared over the waves' length
# squared; a force of some hundred newtons follows [N], [N m].
QUOTIENT = 1e-4
RADIUS, GRAVITY = 0.150, 9.81


def moment_at(x: float) -> StepContext:
    nought, one = jnp.zeros(()), jnp.ones(())
    return StepContext(nought, one, jnp.array([x, 0.0]), jnp.zeros(2), nought, one, one, one)


def test_sand_passes_from_soft_to_hard_at_a_place():
    effect = KNOWN["terrain_step"](excess=0.2, centre=0.6, width=0.05)
    factors = [float(effect.factor(moment_at(x), ())) for x in (0.0, 0.55, 0.6, 0.65, 1.2)]
    # Twelve widths away tanh is one to 1e-10; at one width it is (e - 1/e) / (e + 1/e).
    across = 0.2 * (np.e - 1 / np.e) / (np.e + 1 / np.e)
    np.testing.assert_allclose(factors, [0.8, 1 - across, 1.0, 1 + across, 1.2], atol=1e-9)


WAVES = {"first": (0.002, -0.001, 0.45), "second": (0.0005, 0.003, 0.13)}


def one(name: str, wave: tuple[float, float, float]):
    cosine, sine, length = wave
    return KNOWN[name](cosine=cosine, sine=sine, length=length)


def together(name: str, waves: dict[str, tuple[float, float, float]]):
    names = ("cosine", "sine", "length")
    pairs = (
        (f"{which}_{n}", v) for which, w in waves.items() for n, v in zip(names, w, strict=True)
    )
    return KNOWN[name](**dict(pairs))


def test_several_waves_of_zeta_add_up():
    waves = {**WAVES, "third": (0.04, 0.02, 1.1)}
    effect = together("terrain_waves", waves)
    alone = [one("terrain_wave", each) for each in waves.values()]
    for x in (-0.7, 0.0, 0.21, 1.9):
        changes = [float(each.factor(moment_at(x), ())) - 1 for each in alone]
        found = float(effect.factor(moment_at(x), ()))
        assert found == pytest.approx(1 + sum(changes), abs=CLOSE)


def test_each_plate_is_under_the_waves_over_it():
    effect = together("surface_waves", WAVES)
    axle, ahead = 0.3, np.array([-0.1, 0.0, 0.04])
    alone = [one("surface_profile", each) for each in WAVES.values()]
    # A wave's plane has the wave's own height under the axle.
    expected = [sum(float(e.plane(jnp.asarray(axle + a), ())[0]) for e in alone) for a in ahead]
    found = effect.height(jnp.asarray(axle), jnp.asarray(ahead), ())
    np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE)


@pytest.mark.parametrize("radius", [0.040, 0.068, 0.150, 0.300])
def test_a_floor_is_looked_for_where_the_plates_of_any_wheel_are(radius):
    starts = np.asarray(field_metadata(KNOWN["rigid_floor"])["floor"]["starts"])
    # Grousers of an eighth of the radius, on a wheel that sinks by a fifth of it.
    deepest = radius * (1 / 8 + 1 / 5)
    assert np.any((starts > 0.6 * deepest) & (starts < 0.9 * deepest))


@pytest.mark.parametrize(("lowest", "highest", "apart"), [(1, 10, 1 / 8), (10, 30, 1 / 4)])
def test_a_ripple_of_any_order_has_a_start_near_it(lowest, highest, apart):
    """A gear's ratio need not be whole."""
    starts = np.asarray(field_metadata(KNOWN["speed_ripple"])["order"]["starts"])
    orders = np.linspace(lowest, highest, 1000)
    assert np.abs(orders[:, None] - starts).min(axis=1).max() <= apart


def test_sand_loosens_late_and_at_once_or_early_and_long():
    late = KNOWN["loosening_stretched"](loss=0.2, decay=2.0, exponent=2.0)
    early = KNOWN["loosening_stretched"](loss=0.2, decay=2.0, exponent=0.5)
    here = moment_at(0.0)
    for effect, powers in ((late, (1 / 16, 1.0, 4.0)), (early, (0.5, 1.0, 2**0.5))):
        factors = [float(effect.factor(here, jnp.asarray(turned))) for turned in (0.5, 2.0, 4.0)]
        np.testing.assert_allclose(factors, 0.8 + 0.2 * np.exp(-np.array(powers)), rtol=CLOSE)


def test_a_stretched_loosening_of_exponent_one_is_the_plain_one():
    plain = KNOWN["loosening"](loss=0.2, decay=2.0)
    other = KNOWN["loosening_stretched"](loss=0.2, decay=2.0, exponent=1.0)
    here, turned = moment_at(0.0), [jnp.asarray(each) for each in (0.01, 0.5, 2.0, 30.0)]
    factors = [[float(each.factor(here, t)) for t in turned] for each in (plain, other)]
    np.testing.assert_allclose(*factors, rtol=CLOSE)


# Height decrease by the arc that truly touches


def with_arc(share: float, wheel=GROUSERS) -> Simulator:
    return replace(simulator(wheel), effects=(KNOWN["height_decrease_arc"](share=share),))


def test_sand_is_lower_behind_the_middle_of_the_arc_by_hand():
    # Axle 0.12 m over the sand, which is 0.02 m lower behind: the rim of 0.15 m enters it at
    # acos(0.8) ahead of straight down and leaves it at acos(0.14 / 0.15) behind. The arc's middle
    # is 7.9 degrees ahead.
    entry, leave, loss = np.arccos(0.8), np.arccos(0.14 / 0.15), 0.02
    middle = (entry - leave) / 2
    omega = np.sqrt(loss * GRAVITY) / RADIUS
    at = (
        jnp.array([0.0, 0.12 - RADIUS]),
        jnp.array([0.1, -0.05]),
        jnp.zeros(()),
        jnp.asarray(omega),
        jnp.asarray(0.8),
    )
    # A law without the inertial term is straight in depth.
    law = Dynamic(inertial_coefficient=0.0)
    level = Simulator(RIM, Terrain(law=replace(law, height_decrease=0.0))).plate_load(*at)
    ahead = np.arctan2(np.asarray(level.plates.x), -np.asarray(level.plates.z))
    depth = np.asarray(level.motion.depth)
    deep = depth > 1e-3
    for share in (0.0, 0.5, 1.0):
        sim = Simulator(RIM, Terrain(law=law), effects=(KNOWN["height_decrease_arc"](share=share),))
        behind = (1 - share) * (ahead < 0) + share * (ahead < middle)
        left = np.maximum(depth - loss * behind, 0) / np.where(deep, depth, 1)
        found = sim.plate_load(*at)
        for part in ("stress_x", "stress_z"):
            expected = left * np.asarray(getattr(level, part))
            np.testing.assert_allclose(
                np.asarray(getattr(found, part))[deep], expected[deep], rtol=CLOSE, atol=CLOSE
            )
    # Between straight down and the middle there are plates, or the two lines were one.
    assert np.sum(deep & (ahead > 0) & (ahead < middle)) > 2


def test_at_300_deg_s_the_line_decides_how_deep_a_wheel_runs():
    dt = 1e-3
    time = dt * np.arange(1, 6001)
    omega = np.interp(time, [0.0, 0.5, 3.0], np.radians([0.0, 0.0, 300.0]))
    start = State.at_rest(0.0176)

    def run(sim):
        return rows(sim, start, omega, dt, 10)

    vertical, arc = jax.jit(jax.vmap(lambda share: run(with_arc(share)).z))(jnp.array([0.0, 1.0]))
    assert np.mean(vertical[-200:]) == pytest.approx(-0.030, abs=WHOLE_MILLIMETRES)
    assert np.mean(arc[-200:]) == pytest.approx(-0.064, abs=WHOLE_MILLIMETRES)
    # The whole share is the law that has the arc's line to begin with.
    law = Simulator(GROUSERS, Terrain(law=Dynamic(bisector=ArcBisector())))
    np.testing.assert_allclose(arc, jax.jit(lambda: run(law).z)(), rtol=0, atol=REACHED)


def test_the_arc_needs_a_law_with_a_height_decrease():
    sim = Simulator(RIM, Terrain(law=QuasiStatic()), effects=(KNOWN["height_decrease_arc"](),))
    with pytest.raises(InputError, match="height_decrease_arc needs the dynamic stress law"):
        sim.check()


# The frame of the surface

SLOPE, MASS = 0.05, 15.0
DT, EVERY = 1e-3, 20
OMEGA = 1.0 + 0.5 * np.sin(np.arange(1, 2001) / 300)


def turned(x, z, angle: float):
    """Parts of a vector (x, z) along a plane that rises by an angle [rad], and normal to it."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * x + sine * z, cosine * z - sine * x


@pytest.mark.parametrize("slope", [SLOPE, -SLOPE], ids=["up", "down"])
def test_a_wheel_on_an_incline_moves_as_on_level_sand_under_tilted_gravity(slope):
    """The world turned by the slope's angle: level sand, and a weight that pulls backward.

    One mass along all axes, as a rig's two masses would tell the two worlds apart.
    """
    angle, rig = np.arctan(slope), Rig(mass_x=MASS, mass_z=MASS)
    weight = MASS * GRAVITY
    tilted_gravity = (
        KNOWN["drawbar"](force=weight * np.sin(angle)),
        KNOWN["vertical_load"](force=-weight * (1 - np.cos(angle))),
    )
    sand = replace(simulator(GROUSERS), rig=rig)
    level = replace(sand, effects=tilted_gravity)
    inclined = replace(sand, effects=(KNOWN["surface_incline"](slope=slope),))
    # The wheel's angle counts from the vertical, which is another line in the turned world.
    start = replace(driven(False, 1.0), angle=jnp.asarray(0.3))
    x, z = turned(start.position[0], start.position[1] + RADIUS, -angle)
    there = replace(
        start,
        position=jnp.stack([x, z - RADIUS]),
        velocity=jnp.stack(turned(*start.velocity, -angle)),
        angle=start.angle - angle,
    )
    expected = jax.jit(lambda: rows(level, start, OMEGA, DT, EVERY))()
    found = jax.jit(lambda: rows(inclined, there, OMEGA, DT, EVERY))()
    along, above = turned(np.asarray(found.x), np.asarray(found.z) + RADIUS, angle)
    np.testing.assert_allclose(along, expected.x, rtol=0, atol=REACHED * len(OMEGA))
    np.testing.assert_allclose(above - RADIUS, expected.z, rtol=0, atol=REACHED)
    push, lift = turned(np.asarray(found.fx), np.asarray(found.fz), angle)
    np.testing.assert_allclose(push, expected.fx, rtol=0, atol=FOUND)
    np.testing.assert_allclose(lift, expected.fz, rtol=0, atol=FOUND)
    np.testing.assert_allclose(found.torque, expected.torque, rtol=0, atol=FOUND)


def test_a_wheel_on_waves_feels_the_plane_that_touches_them_under_its_axle():
    """Force and torque in single places, against level sand in the turned world."""
    length, cosine, sine = 0.37, 0.004, 0.002

    def wave(x: float) -> float:
        phase = 2 * np.pi * x / length
        return cosine * (np.cos(phase) - 1) + sine * np.sin(phase)

    waves = KNOWN["surface_undulation"](cosine=cosine, sine=sine, length=length)
    level, wavy = simulator(GROUSERS), replace(simulator(GROUSERS), effects=(waves,))
    velocity, wheel_angle, omega, zeta = np.array([0.12, -0.02]), 0.3, 1.0, 0.8
    steepest = 0.0
    for x in (-0.4, 0.0, 0.11, 1.3):
        angle = np.arctan((wave(x + 1e-5) - wave(x - 1e-5)) / 2e-5)
        height = RADIUS - 0.03
        rest = (jnp.asarray(omega), jnp.asarray(zeta))
        at = (jnp.array([0.0, height * np.cos(angle) - RADIUS]),
              jnp.stack(turned(*velocity, angle)),
              jnp.asarray(wheel_angle + angle))  # fmt: skip
        fx, fz, torque = np.asarray(level.wrench(*at, *rest))
        place = jnp.array([x, wave(x) + height - RADIUS])
        found = wavy.wrench(place, jnp.asarray(velocity), jnp.asarray(wheel_angle), *rest)
        expected = [*turned(fx, fz, -angle), torque]
        np.testing.assert_allclose(found, expected, rtol=0, atol=QUOTIENT)
        steepest = max(steepest, abs(angle))
    assert steepest > SLOPE
    # The origin is the datum.
    assert float(waves.plane(jnp.zeros(()))[0]) == 0.0


def test_a_tilted_bed_slows_a_wheel_more_than_its_depth_alone_does():
    """The sand's force leans back with the bed: at 5 % a wheel loses more than twice the way."""
    omega = np.interp(DT * np.arange(1, 6001), [0.0, 1.0], [0.0, 0.5236])
    start = State.at_rest(0.0176)

    def way(name: str):
        def of(slope):
            sim = replace(simulator(GROUSERS), effects=(KNOWN[name](slope=slope),))
            return rows(sim, start, omega, DT, EVERY).x[-1]

        level, up = jax.jit(jax.vmap(of))(jnp.array([0.0, SLOPE]))
        return float(level - up)

    assert way("surface_incline") > 2 * way("surface_slope") > 0
