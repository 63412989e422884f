"""A wheel that turns backward: what the mirror turns round, and what is fixed in space.

Mirrored about the vertical through its start, a run that goes forward is one that goes backward: x
and what points along it change sign, z and what points up stay. That holds of the law itself and
of every effect that knows no direction. Of an effect that is fixed in space, or to the wheel, it
holds once the effect is mirrored as well, and not before.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.effects.base import StepContext
from drftjax.effects.catalogue import field_metadata, shapes
from drftjax.effects.serialization import build_effects
from drftjax.physics.command import with_zero_crossings
from drftjax.physics.state import Output, State
from drftjax.physics.stress import ArcBisector, Dynamic
from drftjax.physics.terrain import Terrain
from drftjax.simulation.simulator import Simulator
from tests.helpers.effect_runs import (
    GROUSERS,
    KNOWN,
    NUMBERS,
    ON_FREE,
    RIM,
    rows,
    typical,
    vector,
    with_effects,
)

# The plates of a mirrored wheel are added up in another order. Of a wheel on sand what rounding
# changes dies out, but a plate that is about to lead tells of it in its force before [m], [N].
# A wheel that sets off is at such a corner, and goes some 1e-8 m farther or less; its slip is that
# speed over a rim's of some centimetres a second.
ROUNDING, FORCE_ROUNDING = 1e-6, 3e-4
# Share of the top speed.
SETTING_OFF = 0.02
# Nine lengths of a pile on, e^-9 = 1.2e-4 of it is still to come; twice that.
PILED = 2.5e-4
# Far over that, and far under what an effect fixed in space does on the wrong side [m].
SEEN = 1e-6
# The same of a force [N] or a torque [N m].
FORCE_SEEN = 0.1
# Forward and reverse mode are two programs, whose roundings a wheel that turns round magnifies.
ORDER = 1e-6
# No number changes a sum of some hundred samples by more than 14 per unit, a compliance per mm/N;
# derivatives that grow from step to step pass 1e20 in a second.
BOUNDED = 50.0
PER_UNIT = np.array([1e-3 if field == "compliance" else 1.0 for _, field in NUMBERS])

# Not zero: a grouser straight under the axle stands at the very corner of the leading-plate rule,
# where a rounding decides which of its faces leads.
ANGLE, SINKAGE = 0.1, 0.0176
# A run backward mirrors one forward by this form of the height decrease only.
MIRRORED = Dynamic(bisector=ArcBisector())
DT, EVERY = 1e-3, 10
TIME = DT * np.arange(1, 2001)
FAST = np.interp(TIME, [0.0, 0.2, 1.2, 1.8, 2.0], np.radians([0.0, 0.0, 300.0, 300.0, 200.0]))
# As sharp a reversal as this step follows with bounded derivatives.
REVERSAL = np.array([0.0, 0.2, 0.6, 0.7, 1.5, 2.0]), np.array([0.0, 0.0, 0.39, 0.39, -0.39, -0.39])
REVERSED = np.interp(TIME, *REVERSAL)

TURNED = ("x", "vx", "angle", "omega", "fx", "torque")
KEPT = ("z", "vz", "fz", "slip", "sinkage", "zeta")

# By effect: the numbers that are the other way round in the mirror, and why.
MIRROR: dict[str, tuple[tuple[str, ...], str]] = {
    "speed_gain": ((), "a ratio of speeds"),
    "carriage_gain": ((), "a ratio of speeds"),
    "speed_lag": ((), "a drive is as late either way"),
    "speed_ripple": (("sine",), "locked to an angle, which the mirror counts the other way"),
    "speed_harmonics": (("sine", "sine2"), "locked to an angle, too"),
    "backlash": ((), "the play is crossed from its middle either way"),
    "wheel_radius": ((), "a round rim"),
    "grouser_height": ((), "grousers have two faces alike"),
    "grouser_shadowing": ((), "grousers have two faces alike"),
    "eccentricity": (("along",), "fixed to the wheel"),
    "imbalance": (("along",), "fixed to the wheel"),
    "loosening": ((), "turning counts either way"),
    "loosening_stretched": ((), "turning counts either way"),
    "slip_softening": ((), "slip counts either way"),
    "slip_ratio_softening": ((), "slip counts either way"),
    "slip_power_softening": ((), "slip counts either way"),
    "sinkage_hardening": ((), "depth"),
    "terrain_variation": (("centre",), "a patch stays where it is"),
    "terrain_wave": (("sine",), "waves stay where they are"),
    "terrain_waves": (("first_sine", "second_sine", "third_sine"), "waves stay where they are"),
    "terrain_step": (("excess", "centre"), "harder ahead is softer behind"),
    "bulldozing": ((), "sand piles up on the side that the wheel goes to"),
    "heap": ((), "a heap stands on the side that the wheel goes to"),
    "rate_hardening": ((), "a plate's speed knows no direction"),
    "depth_hardening": ((), "depth"),
    "depth_power": ((), "depth"),
    "rigid_floor": ((), "depth"),
    "cohesion": ((), "depth"),
    "momentum_flux": ((), "the square of a speed along a normal"),
    "height_decrease": ((), "behind is where the wheel comes from"),
    "height_decrease_arc": ((), "the arc lies where the wheel comes from"),
    "surface_profile": (("sine",), "waves stay where they are"),
    "surface_undulation": (("sine",), "waves stay where they are"),
    "surface_waves": (("first_sine", "second_sine"), "waves stay where they are"),
    "surface_bump": (("centre",), "a bump stays where it is"),
    "surface_slope": (("slope",), "what rises ahead falls behind"),
    "surface_incline": (("slope",), "what rises ahead falls behind"),
    "excavation": ((), "slip digs either way"),
    "slip_sinkage": ((), "slip digs either way"),
    "vertical_load": ((), "vertical"),
    "vertical_coulomb": ((), "vertical"),
    "vertical_creep_friction": ((), "vertical"),
    "vertical_viscous": ((), "vertical"),
    "horizontal_coulomb": ((), "friction opposes any motion"),
    "horizontal_viscous": ((), "friction opposes any motion"),
    "drawbar": (("force",), "a tilted rail pulls one way"),
    "cable_spring": ((), "a spring pulls back to where it was slack"),
    "vertical_spring": ((), "vertical"),
    "surface_spring": ((), "vertical"),
    "vertical_compliance": ((), "vertical"),
    "sinkage_gain": ((), "vertical"),
    "sinkage_offset": ((), "vertical"),
    "sinkage_drift": ((), "vertical"),
    "travel_gain": ((), "a ratio of lengths"),
    "force_offset": (("fx_offset",), "a sensor's zero knows no wheel"),
    "force_gain": ((), "a ratio of forces"),
    "force_crosstalk": (("fz_in_fx", "fx_in_fz"), "a tilt of the sensor stays"),
    "torque_offset": (("offset",), "a sensor's zero knows no wheel"),
    "torque_friction": ((), "friction opposes any turning"),
    "torque_gain": ((), "a ratio of torques"),
    "channel_delay": ((), "time"),
    "travel_delay": ((), "time"),
    "sinkage_delay": ((), "time"),
    "measurement_delay": ((), "time"),
    "measurement_filter": ((), "time"),
}
DIRECTED = [name for name, (fields, _) in MIRROR.items() if fields]


@cache
def program():
    """All effects in one program, started from rest at an angle."""

    def run(values, angle, omega):
        start = State.at_rest(SINKAGE, angle=angle)
        return rows(with_effects(GROUSERS, values, law=MIRRORED), start, omega, DT, EVERY)

    return jax.jit(run)


def ran(given: dict, angle: float, omega: np.ndarray) -> Output:
    return jax.tree.map(np.asarray, program()(jnp.asarray(vector(**given)), angle, omega))


def sizes(name: str) -> dict[str, float]:
    """Typical strengths, and shapes that such a short run can feel."""
    places = "terrain_variation", "terrain_step", "surface_bump"
    near = {each: {"centre": 0.4} for each in places}
    given = {field: float(getattr(KNOWN[name](), field)) for field in shapes(KNOWN[name])}
    return typical(name) | given | near.get(name, {})


def mirrored(name: str) -> dict[str, float]:
    fields, _ = MIRROR[name]
    return {field: -v if field in fields else v for field, v in sizes(name).items()}


def assert_mirrors(forward: Output, backward: Output):
    speed = np.abs(forward.omega)
    # Just as it sets off, a wheel is at a corner: which of two velocities it takes is rounding's.
    sets_off = (speed > 0) & (speed < SETTING_OFF * speed.max())
    for sign, channels in ((-1, TURNED), (1, KEPT)):
        for channel in channels:
            tolerance = FORCE_ROUNDING if channel in ("fx", "fz", "torque") else ROUNDING
            np.testing.assert_allclose(
                (sign * getattr(backward, channel))[~sets_off],
                getattr(forward, channel)[~sets_off],
                rtol=0, atol=tolerance, err_msg=channel,
            )  # fmt: skip


@pytest.mark.parametrize("wheel", [GROUSERS, RIM], ids=["grousers", "plain"])
def test_a_fast_wheel_that_turns_backward_is_the_mirror_of_one_that_turns_forward(wheel):
    @jax.jit
    def run(sense, height_decrease):
        law = Dynamic(height_decrease=height_decrease, bisector=ArcBisector())
        sim = Simulator(wheel, Terrain(law=law))
        return rows(sim, State.at_rest(SINKAGE, angle=sense * ANGLE), sense * FAST, DT, EVERY)

    forward, backward = run(1.0, 1.0), run(-1.0, 1.0)
    assert_mirrors(forward, backward)
    # It gets somewhere: of the metre that its rim turns a plain wheel loses 0.6.
    assert forward.x[-1] > 0.3
    # The sand lowered behind is what makes the two sides differ here.
    level = run(1.0, 0.0)
    assert np.abs(forward.z - level.z).max() > 1e-3


def test_every_effect_says_what_the_mirror_does_to_it():
    assert list(MIRROR) == list(KNOWN)
    for name, (fields, why) in MIRROR.items():
        assert why
        assert set(fields) <= set(field_metadata(KNOWN[name]))


@pytest.mark.parametrize("name", ON_FREE)
def test_an_effect_goes_backward_as_its_mirror_image_goes_forward(name):
    forward = ran({name: sizes(name)}, ANGLE, FAST)
    assert_mirrors(forward, ran({name: mirrored(name)}, -ANGLE, -FAST))


@pytest.mark.parametrize("name", DIRECTED)
def test_an_effect_fixed_in_space_or_to_the_wheel_does_not_mirror_by_itself(name):
    forward, backward = (ran({name: sizes(name)}, s * ANGLE, s * FAST) for s in (1, -1))
    shown_in = KNOWN[name].about.channels or ("x", "z")
    apart = {
        channel: np.abs(
            getattr(forward, channel)
            + (1 if channel in TURNED else -1) * getattr(backward, channel)
        ).max()
        for channel in shown_in
    }
    assert max(apart.values()) > (SEEN if set(shown_in) <= {"x", "z"} else FORCE_SEEN)


# By programs of a part of the effects each: one that goes back through all takes longer to compile.
PARTS = tuple(ON_FREE[first::4] for first in range(4))


@cache
def slopes(part: tuple[str, ...]):
    """Derivatives of a run that reverses by numbers of some effects: reverse mode, and along one.

    Returns:
        The program, and the direction in which it takes the other.
    """
    weights = np.random.default_rng(0).normal(size=(2, len(TIME) // EVERY + 1))
    along = np.random.default_rng(1).normal(size=len(NUMBERS)) * np.abs(vector_of_sizes())

    def outcome(values):
        start = State.at_rest(SINKAGE, angle=jnp.asarray(ANGLE))
        sim = with_effects(GROUSERS, values, part, law=MIRRORED)
        output = rows(sim, start, REVERSED, DT, EVERY)
        return jnp.sum(weights * jnp.stack([output.x, output.z])), output

    def both(values):
        gradient, output = jax.grad(outcome, has_aux=True)(values)
        forward = jax.jvp(lambda v: outcome(v)[0], (values,), (jnp.asarray(along),))[1]
        return gradient, forward, output

    return jax.jit(both), along


def vector_of_sizes() -> np.ndarray:
    return vector(**{name: sizes(name) for name in KNOWN})


@pytest.mark.parametrize("name", ON_FREE)
def test_a_run_that_reverses_half_way_is_finite_and_its_derivatives_bounded(name):
    run, along = slopes(next(part for part in PARTS if name in part))
    gradient, forward, output = run(jnp.asarray(vector(**{name: sizes(name)})))
    for channel in (*TURNED, *KEPT):
        assert np.isfinite(getattr(output, channel)).all(), channel
    assert output.omega.min() < 0 < output.omega.max()
    assert output.x.argmax() not in (0, len(output.x) - 1), "it goes, and comes back"
    assert np.abs(gradient * PER_UNIT).max() < BOUNDED
    assert float(gradient @ along) == pytest.approx(float(forward), rel=ORDER)


def resistance(turns, speed=1.0, dt=0.01):
    """What bulldozing adds along x [N] of a wheel that rolls by these angles one after another."""
    effect = KNOWN["bulldozing"](force=5.0, length=0.05)
    nought, radius = jnp.zeros(()), jnp.asarray(0.15)
    memory, x, felt = effect.begin(jnp.zeros(2)), 0.0, []
    for turn in turns:
        omega = speed * np.sign(turn)
        for _ in range(round(abs(turn) / (speed * dt))):
            position = jnp.asarray([x, 0.0])
            velocity = jnp.asarray([0.15 * omega, 0.0])
            moment = StepContext(nought, jnp.asarray(dt), position, velocity, nought,
                            jnp.asarray(omega), jnp.asarray(omega), radius)  # fmt: skip
            x += 0.15 * omega * dt
            felt.append(effect.load(jnp.asarray([x, 0.0]), velocity, moment, memory)[0])
            memory = effect.advance(memory, moment)
        felt, done = [], felt
        yield np.asarray(done)


def test_sand_piles_up_against_the_wheel_whichever_way_it_goes():
    ahead, back = resistance([3.0, -3.0])
    assert np.all(ahead < 0)
    assert ahead[-1] == pytest.approx(-5.0, rel=PILED)
    assert np.all(back[10:] > 0)
    assert back[-1] == pytest.approx(5.0, rel=PILED)
    # It never drives the wheel for longer than it takes to part from the pile.
    assert np.all(np.diff(back) > 0)


def test_a_wheel_that_turns_back_a_little_finds_its_pile_again():
    ahead, back, again = resistance([3.0, -0.04, 0.1])
    # Six millimetres back, of a length of 50, it bears on the wheel a little more than half.
    assert back[-1] > 0.6 * ahead[-1]
    assert again[-1] == pytest.approx(ahead[-1], rel=PILED)


def test_a_patch_may_lie_behind_the_start():
    assert build_effects({"name": "terrain_variation", "excess": 0.1, "centre": -0.4}, 1) == KNOWN[
        "terrain_variation"
    ](excess=0.1, centre=-0.4)


def test_a_profile_that_turns_back_has_a_knot_where_it_does():
    time, omega, vx = np.arange(4.0), np.array([0.0, 1.0, -3.0, -3.0]), np.array([0.0, 1, 2, -2])
    found = with_zero_crossings(time, omega, vx)
    np.testing.assert_allclose(found[0], [0, 1, 1.25, 2, 2.5, 3])
    np.testing.assert_allclose(found[1], [0, 1, 0, -3, -3, -3])
    np.testing.assert_allclose(found[2], [0, 1, 1.25, 2, 0, -2])
    assert with_zero_crossings(time, np.abs(omega))[0] is time
