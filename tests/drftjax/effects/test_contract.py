"""What every effect of the catalogue promises: an exact null, and derivatives that tell at it.

All effects stand in one simulator, most at zero strength, so that one program serves every test.
The runs start from a moving wheel: at rest a rounding decides which plates lead.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.effects import composition
from drftjax.effects.base import (
    AbstractAdjustment,
    AbstractDrive,
    AbstractIncline,
    AbstractLoad,
    AbstractPlacement,
    AbstractSensor,
    AbstractStressFactor,
    AbstractSurface,
    AbstractZetaFactor,
    StepContext,
)
from drftjax.effects.catalogue import OURS, catalogue, field_metadata, shapes, strengths
from drftjax.physics.command import Command
from drftjax.physics.rig import DrivenCarriage, Rig
from drftjax.physics.state import State
from drftjax.physics.stress import plate_motion
from drftjax.runlog.hdf5.api import read_run
from drftjax.simulation.rollout import sweep
from drftjax.simulation.statics import sinkage_under_load
from tests.helpers.effect_runs import (
    GROUSERS,
    KNOWN,
    NUMBERS,
    ON_FREE,
    STRENGTHS,
    built,
    commands,
    driven,
    rows,
    simulator,
    typical,
    vector,
    with_effects,
)

# Two programs of the same arithmetic, one with the null effects and one without: the compiler
# joins multiplications and additions in other places. So the null run may be no further from the
# plain one than runs whose commands are one unit in the last place off are: of so many the
# furthest, twice.
ROUNDED = 20
ROUNDING = 2
# About as in test_gradients: parts in a thousand, of the largest change of that channel. What
# changes little is rougher beside its own size; forces are, where a plate turns over.
AGREEMENT = 3e-3
# Share of the typical strength. Longer changes pass corners, shorter ones drown in rounding.
CHANGES = (1e-7, 3e-7, 1e-6)
# Sums and products of some doubles in another order.
SUMS = 1e-13
# The smallest change of a reading that a typical effect makes here [m], [N]: far under any noise
# that could hide it, far over rounding.
FELT = 1e-8

DT, STEPS, EVERY = 1e-3, 600, 20
PROFILE_STEPS, PROFILE_EVERY = 4000, 400
MOST_STEPS, MOST_ROWS = PROFILE_STEPS, STEPS // EVERY
SPEED = 0.6
OMEGA = SPEED * (1 + 0.3 * np.sin(2 * np.pi * np.arange(1, STEPS + 1) / STEPS))
CHANNELS = ("x", "z", "fx", "fz", "torque")
START = partial(driven, False, SPEED)
DRIVEN = Rig(carriage=DrivenCarriage())
NULL_VECTOR = vector()
TYPICAL = np.asarray([typical(name)[field] for name, field in STRENGTHS])
PLACES = np.asarray([NUMBERS.index(each) for each in STRENGTHS])

# They put another part into the model, which gives the same stress.
RESTRUCTURED = ("height_decrease_arc",)

effects = pytest.mark.parametrize("name", list(KNOWN))


class Drive(NamedTuple):
    """A run: where it starts, and the wheel's speed [rad/s] at the end of each step of `dt` [s].

    As many as `MOST_STEPS`, for one program; `rows` of `every` steps are made.
    """

    start: State
    omega: jax.Array
    dt: jax.Array
    rows: jax.Array
    every: jax.Array


def drive(start: State, omega: np.ndarray, dt: float, every: int) -> Drive:
    counts = (jnp.asarray(each, int) for each in (len(omega) // every, every))
    padded = jnp.asarray(np.pad(omega, (0, MOST_STEPS - len(omega)), mode="edge"))
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), start)
    return Drive(start, padded, jnp.asarray(dt), *counts)


def readings(values, run: Drive):
    """Channels (5, 1 + MOST_ROWS) of a run with the effects at these numbers; zero past its end."""

    def command(time):
        omega = run.omega[jnp.maximum(jnp.round(time / run.dt).astype(int) - 1, 0)]
        return Command(omega, jnp.zeros_like(omega), jnp.zeros_like(omega))

    def keep(output):
        return jnp.stack([getattr(output, name) for name in CHANNELS])

    interval = run.dt * run.every.astype(float)
    sim = with_effects(GROUSERS, values)
    return sweep(sim, run.start, command, interval, run.every, run.rows, MOST_ROWS, keep)


def driven_readings(values, _):
    """The same of a driven carriage that is given half of the rim's speed."""
    sim = replace(simulator(), rig=DRIVEN, effects=built(values, only=("carriage_gain",)))
    output = rows(sim, START(), OMEGA, DT, EVERY, 0.5 * OMEGA * sim.wheel.radius)
    return jnp.stack([getattr(output, name) for name in CHANNELS])


def direction(index) -> np.ndarray:
    along = np.zeros(len(NUMBERS))
    along[PLACES[index]] = TYPICAL[index]
    return along


ON_DRIVEN = [k for k, (name, _) in enumerate(STRENGTHS) if name not in ON_FREE]
DIRECTIONS = np.stack([direction(k) for k in range(len(STRENGTHS))])


@partial(jax.jit, static_argnums=0)
def with_derivatives(readings, table, directions, run):
    """Readings of a run at each row of a table, and their derivatives along each direction.

    One program for the null, the differences about it and the profiles: all 58 effects take longer
    to compile than to run.
    """

    def one(at, along):
        return jax.jvp(lambda values: readings(values, run), (at,), (along,))

    return jax.vmap(one)(table, directions)


def at_shifted(change: float) -> tuple[np.ndarray, np.ndarray]:
    """Readings, and derivatives per typical strength, where each in turn is changed from null.

    Args:
        change: Share of the typical strengths; 0 for the null.

    Returns:
        Both of shape (strengths, 5, rows).
    """
    run = drive(START(), OMEGA, DT, EVERY)
    table = NULL_VECTOR + change * DIRECTIONS
    both = with_derivatives(readings, table, DIRECTIONS, run)
    found = [np.array(each[..., : 1 + STEPS // EVERY]) for each in both]
    of_driven = with_derivatives(driven_readings, table[ON_DRIVEN], DIRECTIONS[ON_DRIVEN], None)
    for each, driven_one in zip(found, of_driven, strict=True):
        each[ON_DRIVEN] = driven_one
    return found[0], found[1]


@pytest.fixture(scope="module")
def null():
    """Readings at the null, and their derivatives per typical strength (strengths, 5, rows)."""
    values, along = at_shifted(0.0)
    on_free = next(k for k in range(len(STRENGTHS)) if k not in ON_DRIVEN)
    return values[on_free], along


@pytest.fixture(scope="module")
def differences():
    """Central differences per typical strength: (changes, strengths, 5, rows)."""
    return np.stack([(at_shifted(c)[0] - at_shifted(-c)[0]) / (2 * c) for c in CHANGES])


def test_the_catalogue_holds_ours_first_with_names_of_their_own():
    assert list(catalogue())[: len(OURS)] == [each.about.name for each in OURS]
    assert len(set(KNOWN)) == len(OURS) == 65


@effects
def test_an_effect_says_what_it_is(name):
    effect = KNOWN[name]
    assert effect.about.stage in ("drive", "wheel", "terrain", "rig", "sensor")
    assert effect.about.formula
    assert effect.about.meaning
    assert strengths(effect), "an effect has a strength"
    assert set(strengths(effect)) | set(shapes(effect)) == set(field_metadata(effect))
    for about in field_metadata(effect).values():
        assert about["unit"]
        assert about["meaning"]
    for field in shapes(effect):
        starts = field_metadata(effect)[field]["starts"]
        assert min(starts) > 0
        assert min(starts) <= float(getattr(effect(), field)) <= max(starts)


@effects
def test_at_zero_strength_every_hook_gives_back_what_it_was_given(name):
    effect = KNOWN[name]()
    random = np.random.default_rng(1)
    sim = simulator().prepared()
    state = replace(START(), angle=jnp.asarray(0.3))
    command = jax.tree.map(lambda c: c[0], commands(OMEGA))
    output = sim.observe(state, command)
    dt = jnp.asarray(DT)
    pair = jnp.asarray(random.normal(size=2))
    moment = StepContext(
        *map(jnp.asarray, (0.3, DT)),
        pair,
        0.1 * pair,
        *map(jnp.asarray, (1.0, 0.5)),
        jnp.asarray(0.5),
        sim.wheel.radius,
    )
    plates = sim.wheel.cut().plates(state.angle)
    motion = plate_motion(
        plates, jnp.asarray(0.13), pair, moment.omega, jnp.asarray(0.0), 1e-6, sim.wheel.radius
    )

    def same(a, b):
        assert jax.tree.structure(a) == jax.tree.structure(b)
        pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
        assert all(jnp.array_equal(p, q) for p, q in pairs)

    seen = False
    if isinstance(effect, AbstractAdjustment):
        model = simulator() if name in ON_FREE else replace(simulator(), rig=DRIVEN)
        changed = effect.adjust(model)
        if name not in RESTRUCTURED:
            same(changed, model)
        at = state.position, state.velocity, state.angle, state.omega, jnp.ones(())
        same(changed.plate_load(*at), model.plate_load(*at))
        seen = True
    if isinstance(effect, AbstractDrive):
        memory = effect.begin(jnp.asarray(0.2), jnp.asarray(0.1))
        same(effect.turn(jnp.asarray(0.7), state.angle, dt, memory)[0], jnp.asarray(0.7))
        seen = True
    if isinstance(effect, AbstractPlacement):
        same(effect.place(plates, state.angle), plates)
        seen = True
    if isinstance(effect, AbstractZetaFactor):
        memory = effect.advance(effect.begin(), moment)
        same(effect.factor(moment, memory), jnp.ones(()))
        seen = True
    if isinstance(effect, AbstractStressFactor):
        same(effect.factor(motion), jnp.ones_like(motion.depth))
        seen = True
    if isinstance(effect, AbstractSurface):
        memory = effect.advance(effect.begin(), moment)
        height = effect.height(state.position[0], plates.x, memory)
        same(jnp.abs(height), jnp.zeros_like(plates.x))
        seen = True
    if isinstance(effect, AbstractIncline):
        frame = composition.surface_frame((effect,), state.position[0])
        same(frame.plates(plates), plates)
        same(frame.distance(state.position[1]), state.position[1])
        same(frame.velocity(pair), pair)
        same(frame.stress_in_space(plates.x, plates.z), (plates.x, plates.z))
        seen = True
    if isinstance(effect, AbstractLoad):
        memory = effect.advance(effect.begin(0 * pair), moment)
        same(jnp.abs(effect.load(pair, pair, moment, memory)), jnp.zeros(2))
        seen = True
    if isinstance(effect, AbstractSensor):
        memory = jax.tree.map(lambda leaf: leaf + 0.1, effect.begin(output))
        same(effect.read(output, dt, memory)[0], output)
        seen = True
    assert seen, "it plugs into a stage"


def test_the_run_with_every_effect_at_zero_is_the_run_without(null):
    start = START()

    @jax.vmap
    def run(omega):
        output = rows(simulator(), start, omega, DT, EVERY)
        return jnp.stack([getattr(output, name) for name in CHANNELS])

    ulps = np.random.default_rng(0).integers(-1, 2, (ROUNDED, STEPS))
    plain, *rounded = jax.jit(run)(jnp.stack([OMEGA, *(OMEGA + ulps * np.spacing(OMEGA))]))

    def apart(one):
        return np.abs(one - plain).max(axis=1)

    # A value that none of the rounded commands changes may still be rounded once otherwise.
    last_place = np.spacing(np.abs(plain).max(axis=1))
    most = ROUNDING * np.max([apart(one) for one in rounded], axis=0)
    assert np.all(apart(null[0]) <= np.maximum(most, last_place))


@effects
def test_every_strength_is_felt_at_the_null(name, null):
    for index, (effect, field) in enumerate(STRENGTHS):
        if effect == name:
            assert np.abs(null[1][index]).max() > FELT, field


@effects
def test_derivatives_at_the_null_are_those_of_the_program(name, null, differences):
    for index, (effect, field) in enumerate(STRENGTHS):
        if effect != name:
            continue
        exact = null[1][index]
        # The first row of a late reading holds what the run began with.
        size = np.abs(exact).max(axis=1, keepdims=True) + FELT
        error = np.median(np.abs(differences[:, index] - exact) / size, axis=0)
        assert error.max() < AGREEMENT, field


# Length [s], knots in time [s] and wheel speeds [deg/s]: of the gentlest reference runs (in a
# quarter of the time) and of the fastest (in half of it).
PROFILES = {
    "30 deg/s": (6.0, (0, 0.5, 1.75, 4.25, 5.5, 6), (0, 0, 30, 30, 0, 0)),
    "300 deg/s": (5.0, (0, 0.5, 1.5, 3.5, 4.5, 5), (0, 0, 300, 300, 0, 0)),
}
# Of the time that a reference run takes.
HASTE = 0.5


def over_a_profile(table, along, dt, omega):
    """Channels (5, rows) by row of a table, and their derivatives along each direction."""
    run = drive(State.at_rest(0.0176), omega, dt, PROFILE_EVERY)
    # As many rows as elsewhere, for the same program.
    spare = ((0, len(STRENGTHS) - len(table)), (0, 0))
    given = (np.pad(np.stack(each), spare, mode="edge") for each in (table, along))
    both = with_derivatives(readings, *given, run)
    rows = PROFILE_STEPS // PROFILE_EVERY
    return [np.asarray(each)[: len(table), :, 1 : 1 + rows] for each in both]


@pytest.mark.parametrize("profile", list(PROFILES))
def test_derivatives_stay_finite_over_a_whole_profile_and_bounded_while_it_drives(
    profile,
):
    end, knots, speeds = PROFILES[profile]
    dt = end / PROFILE_STEPS
    omega = np.radians(np.interp(dt * np.arange(1, PROFILE_STEPS + 1), knots, speeds))
    table, along = [], []
    for name in ON_FREE:
        effect = KNOWN[name]
        half = {field: size / 2 for field, size in typical(name).items()}
        table.append(vector(**{name: half}))
        units = half | {field: float(getattr(effect(), field)) for field in shapes(effect)}
        along.append([units.get(f, 0.0) if n == name else 0.0 for n, f in NUMBERS])
    values, changes = over_a_profile(table, along, dt, omega)
    driving = dt * PROFILE_EVERY * np.arange(1, values.shape[2] + 1) < knots[3]
    farthest = np.abs(values[:, 0]).max()
    for name, value, change in zip(ON_FREE, values, changes, strict=True):
        assert np.isfinite(value).all(), name
        assert np.isfinite(change).all(), name
        # As much again of any effect moves the axle by less than the wheel's height, or a third of
        # the way. (While a wheel slows down, steps as long as these lose the derivative.)
        assert np.abs(change[1][driving]).max() < 0.15, name
        assert np.abs(change[0][driving]).max() < 0.3 * farthest, name


@pytest.mark.parametrize("name", ["paper", "fast_300deg"])
def test_derivatives_at_the_null_are_finite_over_the_reference_profiles(name, shared):
    command = read_run(shared / "reference_rigs" / f"{name}.h5").command
    time = HASTE * command.time
    dt = float(time[-1]) / PROFILE_STEPS
    omega = np.interp(dt * np.arange(1, PROFILE_STEPS + 1), time, command.omega)
    table = [NULL_VECTOR] * len(ON_FREE)
    along = [vector(**{each: typical(each)}) - NULL_VECTOR for each in ON_FREE]
    values, changes = over_a_profile(table, along, dt, omega)
    np.testing.assert_array_equal(values, np.broadcast_to(values[0], values.shape))
    for effect, change in zip(ON_FREE, changes, strict=True):
        assert np.isfinite(change).all(), effect
        assert np.abs(change).max() > FELT, effect


def test_loads_factors_and_surfaces_act_in_any_order():
    values = vector(**{name: typical(name) for name in KNOWN})
    forward = built(values, leave_out=("wheel_radius", "grouser_height"))
    sim = simulator().prepared()
    state = START()
    moment = StepContext(
        jnp.asarray(0.3),
        jnp.asarray(DT),
        state.position,
        state.velocity,
        state.angle,
        state.omega,
        state.omega,
        sim.wheel.radius,
    )
    plates = sim.wheel.cut().plates(state.angle)
    height = jnp.asarray(0.13)
    motion = plate_motion(
        plates, height, state.velocity, state.omega, height * 0, 1e-6, sim.wheel.radius
    )

    def everything(effects):
        memory = composition.advance(effects, composition.begin(effects, state), moment)
        place, speed = state.position + 0.1, state.velocity
        return (
            composition.zeta_factor(effects, memory, moment),
            composition.stress_factor(effects, motion),
            composition.relative_to_surface(effects, memory, motion, place[0], plates.x).depth,
            composition.loads(effects, memory, place, speed, moment, of_the_sand=True),
            composition.loads(effects, memory, place, speed, moment, of_the_sand=False),
        )

    for one, other in zip(everything(forward), everything(forward[::-1]), strict=True):
        np.testing.assert_allclose(one, other, rtol=SUMS)


def test_plates_can_be_looked_at_with_effects_and_without_a_run():
    values = vector(**{name: typical(name) for name in KNOWN})
    sim = with_effects(GROUSERS, values)
    state = START()
    load = sim.plate_load(state.position, state.velocity, state.angle, state.omega, jnp.ones(()))
    assert np.isfinite(load.stress_z).all()
    firm = replace(simulator(), effects=(KNOWN["cohesion"](depth=0.004),))
    # Stress as of 4 mm of depth more lifts it by nearly as much.
    assert sinkage_under_load(firm, 0.7) < sinkage_under_load(simulator(), 0.7) - 3e-3


def test_effects_of_several_stages_act_at_once():
    """A sensor's first reading is that of the other effects' sand, and of the sensors before it.

    Where the wheel starts is what the scale read there.
    """
    lag = KNOWN["measurement_filter"](lag=0.2)
    cohesion = KNOWN["cohesion"](depth=0.002)
    gain = KNOWN["travel_gain"](gain=0.5)
    sim = replace(simulator(), effects=(cohesion, gain, lag))
    state = replace(START(), position=jnp.array([0.2, START().position[1]]))
    command = jax.tree.map(lambda c: c[0], commands(OMEGA))
    first = sim.observe(sim.begin(state, command), command)
    bare = replace(simulator(), effects=(cohesion,))
    truth = bare.observe(bare.begin(state, command), command)
    np.testing.assert_allclose(first.fz, truth.fz, rtol=SUMS)
    begun = sim.begin(state, command)
    np.testing.assert_allclose((begun.position[0], first.x), (0.2 / 1.5, 0.2), rtol=SUMS)
