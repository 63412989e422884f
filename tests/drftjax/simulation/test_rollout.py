"""The step is one function: alone, scanned, batched, and under every way of giving zeta."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.command import Command, command_at
from drftjax.physics.integrator import DEFAULT_STEP
from drftjax.physics.state import State
from drftjax.physics.terrain import ConstantZeta, KnotZeta, PerStepZeta, Terrain
from drftjax.simulation.rollout import simulate, step_times, with_first_row
from drftjax.simulation.simulator import Simulator
from tests.studies.runs import profile, roll

# The same operations, compiled in two ways.
COMPILED_APART = 1e-12
# Batches are added up in another order; over a thousand steps on the sand this stays small.
BATCHED = 1e-9
# At rest every rim plate stands at the very corner of the leading-plate rule (n.p = 0), and a
# rounding decides on which side the first step's matrix is taken: a few micrometres.
BATCHED_FROM_REST = 1e-5

# Sums of 48,000 steps, each rounded to 1e-16 of the sum.
SUMMED = 1e-11
# Places of some centimetres in single precision are rounded to 2e-9 m in each of a thousand steps,
# which add up at random or, at the worst, one way.
SINGLE = 1e-6

BATCH = 64


def start_and_commands(duration=1.0, step=DEFAULT_STEP):
    """A wheel that speeds up, deep enough for everything to happen at once."""
    times = step_times(round(duration / step), step)
    knots = jnp.array([0.0, 0.3, 10.0])
    return State.at_rest(0.025), command_at(times, knots, jnp.array([0.0, 0.6, 0.6]))


def with_zeta(zeta):
    return Simulator(terrain=Terrain(zeta))


def assert_equal_runs(a, b, tolerance):
    for name, left in vars(a).items():
        right = getattr(b, name)
        scale = max(1.0, float(jnp.max(jnp.abs(right))))
        assert float(jnp.max(jnp.abs(left - right))) <= tolerance * scale, name


def test_steps_one_by_one_are_the_scanned_run():
    simulator = Simulator().prepared()
    start, commands = start_and_commands(0.5)
    step = jax.jit(lambda state, command: simulator.step(state, command, DEFAULT_STEP))
    state, outputs = start, []
    for command in zip(*map(np.asarray, jax.tree.leaves(commands)), strict=True):
        state, output = step(state, Command(*map(jnp.asarray, command)))
        outputs.append(output)
    one_by_one = jax.tree.map(lambda *rows: jnp.stack(rows), *outputs)
    last, scanned = roll(simulator, start, commands, DEFAULT_STEP)
    assert_equal_runs(one_by_one, scanned, COMPILED_APART)
    np.testing.assert_allclose(state.position, last.position, rtol=0, atol=COMPILED_APART)


def test_rows_kept_are_rows_of_the_whole_run():
    start, commands = start_and_commands()
    _, every = roll(Simulator(), start, commands, DEFAULT_STEP)
    _, some = roll(Simulator(), start, commands, DEFAULT_STEP, every=20)
    assert some.z.shape == (20,)
    kept = jax.tree.map(lambda rows: rows[19::20], every)
    assert_equal_runs(some, kept, COMPILED_APART)


def rolling():
    place, velocity = jnp.array([0.0, -0.030]), jnp.array([0.07, -0.003])
    return State(jnp.zeros(()), place, velocity, jnp.asarray(0.1), jnp.asarray(0.5))


@jax.jit
def of_zeta(zeta, start):
    _, commands = start_and_commands()
    simulator = with_zeta(ConstantZeta(zeta))
    return simulate(simulator, start, commands, DEFAULT_STEP, every=20)[1]


of_zetas = jax.jit(jax.vmap(of_zeta, in_axes=(0, None)))


@pytest.mark.parametrize(
    ("start", "tolerance"),
    [(rolling(), BATCHED), (State.at_rest(0.025), BATCHED_FROM_REST)],
    ids=["rolling", "from-rest"],
)
def test_batch_of_64_zetas_is_64_single_runs(start, tolerance):
    zetas = jnp.linspace(0.4, 1.2, BATCH)
    batch = of_zetas(zetas, start)
    singles = [of_zeta(zeta, start) for zeta in zetas]
    singles = jax.tree.map(lambda *rows: jnp.stack(rows), *singles)
    np.testing.assert_allclose(batch.x, singles.x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(batch.z, singles.z, rtol=0, atol=tolerance)
    # From zeta 0.4 to 1.2 a wheel sinks 20 mm less: these are 64 different runs.
    assert float(jnp.ptp(batch.z[:, -1])) > 0.005


def test_constant_knots_and_per_step_zeta_of_the_same_value_agree():
    start, commands = start_and_commands()
    given = dataclasses.replace(commands, zeta=jnp.full_like(commands.omega, 0.65))
    runs = [
        roll(with_zeta(zeta), start, given, DEFAULT_STEP, every=20)[1]
        for zeta in (ConstantZeta(0.65), KnotZeta([0.0, 5.0], [0.65, 0.65]), PerStepZeta())
    ]
    assert_equal_runs(runs[1], runs[0], COMPILED_APART)
    assert_equal_runs(runs[2], runs[0], COMPILED_APART)


def test_moving_knots_and_the_same_zeta_given_step_by_step_agree():
    start, commands = start_and_commands()
    knots = KnotZeta([0.2, 0.6, 0.8], [0.6, 0.9, 0.7])
    times = step_times(commands.omega.shape[0], DEFAULT_STEP)
    zeta = jnp.interp(times, knots.time, knots.value)
    given = dataclasses.replace(commands, zeta=zeta)
    by_knots = roll(with_zeta(knots), start, given, DEFAULT_STEP, every=20)[1]
    by_step = roll(with_zeta(PerStepZeta()), start, given, DEFAULT_STEP, every=20)[1]
    # Time is added up step by step, so that a knot lies a rounding off.
    np.testing.assert_allclose(by_knots.x, by_step.x, rtol=0, atol=BATCHED)
    np.testing.assert_allclose(by_knots.z, by_step.z, rtol=0, atol=BATCHED)
    assert float(by_knots.zeta[0]) == 0.6
    assert float(jnp.max(by_knots.zeta)) == pytest.approx(0.9, rel=BATCHED)


def test_wheel_turns_by_the_integral_of_its_speed():
    # The paper's profile: two ramps of 5 s and 10 s at 30 deg/s.
    rows = profile().rows(DEFAULT_STEP)
    assert float(jnp.degrees(rows.angle[-1])) == pytest.approx(450.0, rel=SUMMED)
    assert float(rows.time[-1]) == pytest.approx(24.0, rel=SUMMED)


def test_first_row_is_the_start():
    run = profile()
    rows = run.rows(DEFAULT_STEP)
    first = jax.tree.map(lambda values: values[0], run.commands(DEFAULT_STEP))
    whole = with_first_row(run.simulator, run.start(), first, rows)
    assert whole.z.shape == (2401,)
    assert float(whole.time[0]) == 0
    assert float(whole.z[0]) == -0.0176
    assert float(whole.fz[0]) > 0


def test_nothing_but_numbers_makes_a_simulator_compile_anew():
    start, commands = start_and_commands(0.05)
    traces = []

    @eqx.filter_jit
    def run(simulator):
        traces.append(simulator)
        return simulate(simulator, start, commands, DEFAULT_STEP)[1].z

    for zeta in (0.5, 0.6):
        run(with_zeta(ConstantZeta(zeta)))
    assert len(traces) == 1


def test_single_precision_runs_where_it_is_asked_for():
    # Strict promotion is on: a stray double would be refused.
    def single(leaf):
        return leaf.astype(jnp.float32) if eqx.is_inexact_array(leaf) else leaf

    start, commands = start_and_commands()
    with jax.enable_x64(False):
        down = jax.tree.map(single, (with_zeta(ConstantZeta(0.7823)), start, commands))
        rows = roll(*down, DEFAULT_STEP, every=20)[1]
    assert rows.z.dtype == jnp.float32
    double = roll(with_zeta(ConstantZeta(0.7823)), start, commands, DEFAULT_STEP, every=20)[1]
    np.testing.assert_allclose(np.asarray(rows.z), np.asarray(double.z), rtol=0, atol=SINGLE)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: ConstantZeta(-0.1), "zeta"),
        (lambda: ConstantZeta(float("nan")), "zeta"),
        (lambda: KnotZeta([0.0, 0.0], [1.0, 1.0]), "increase"),
        (lambda: KnotZeta([0.0, 1.0], [1.0]), "one value for each knot"),
        (lambda: KnotZeta([0.0, 1.0], [1.0, -1.0]), "zeta"),
    ],
)
def test_zeta_that_cannot_be_is_refused(make, reason):
    with pytest.raises(InputError, match=reason):
        make()
