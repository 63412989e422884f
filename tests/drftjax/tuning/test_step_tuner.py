"""The online tuner, eq. 7: its truth table, its limits, and a replay that is the online loop."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.state import State
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.simulator import Simulator
from drftjax.tuning.replay import ReplaySettings, known_sinkage, replay_tuner
from drftjax.tuning.step_tuner import (
    Loop,
    StepTuner,
    tick_commands,
    tuned_tick,
    with_zeta_per_step,
)

# Scan and single calls run the same operations; only the order of fused sums may differ.
SAME = 1e-12
# Changes of zeta by hand: a rounding of a number of order one, and of it over a tick of 0.01 s.
ROUNDING, RATE_ROUNDING = 1e-15, 1e-13
# The dead band of 0.1 mm is worth 0.005 of zeta, and ripple goes a few steps of 0.001 beyond.
FOLLOWED = 0.01
SUBSTEPS = 5
START = 0.0176
roll = eqx.filter_jit(replay_tuner)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(GrouserWheel(plate_size=0.01))


def commands(ticks: int, tuner: StepTuner, speed: float = 30.0):
    time, omega = jnp.array([0.0, 0.2, 1.0]), jnp.radians(jnp.array([0.0, 0.0, speed]))
    return tick_commands(ticks, SUBSTEPS, tuner.tick, time, omega)


def begin(zeta: float = 0.78) -> Loop:
    return Loop(State.at_rest(START), jnp.asarray(zeta))


# The truth table ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "change"),
    [
        (-2e-4, +1e-3),  # the rig is less deep than simulated: the sand is stronger
        (+2e-4, -1e-3),
        (-0.5e-4, 0.0),
        (+0.5e-4, 0.0),
        (0.0, 0.0),
        (-1e-4, 0.0),  # at the tolerance itself: unchanged
        (+1e-4, 0.0),
        (np.nan, 0.0),  # nothing was measured
    ],
)
def test_zeta_moves_by_one_step_against_an_error_beyond_the_tolerance(error, change):
    tuned, _ = StepTuner().tune((), jnp.asarray(0.78), jnp.asarray(error))
    np.testing.assert_allclose(tuned - 0.78, change, rtol=0, atol=ROUNDING)


def test_zeta_never_turns_negative():
    tuned, _ = StepTuner(zeta_step=0.5).tune((), jnp.asarray(0.3), jnp.asarray(1e-3))
    assert tuned == 0.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tick": 0.0}, "tick is 0, must lie between"),
        ({"tick": float("nan")}, "tick is nan"),
        ({"zeta_step": -1e-3}, "zeta-step is -0.001"),
        ({"tolerance": -1.0}, "tolerance is -1"),
    ],
)
def test_a_tuner_that_cannot_be_is_refused(given, said):
    with pytest.raises(InputError, match=said):
        StepTuner(**given)


# The loop ----------------------------------------------------------------------------------------


def test_replay_is_the_loop_that_runs_tick_by_tick(simulator):
    tuner = StepTuner()
    asked = commands(80, tuner)
    recorded = START + 2e-3 * jnp.sin(jnp.arange(80.0) / 9.0)
    last, ticks = roll(simulator, begin(), asked, recorded, tuner)

    ready, one = with_zeta_per_step(simulator), eqx.filter_jit(tuned_tick)
    loop = begin()
    for number in range(80):
        command = jax.tree.map(lambda values, n=number: values[n], asked)
        loop, tick = one(ready, tuner, loop, command, recorded[number])
        np.testing.assert_allclose(tick.zeta, ticks.zeta[number], rtol=0, atol=SAME)
        np.testing.assert_allclose(tick.output.z, ticks.output.z[number], rtol=0, atol=SAME)
    np.testing.assert_allclose(loop.state.position, last.state.position, rtol=0, atol=SAME)


def test_ticks_without_a_measurement_make_a_longer_tick(simulator):
    tuner, fine = StepTuner(), StepTuner(tick=0.01 / 4)
    time, omega = jnp.array([0.0, 0.2, 1.0]), jnp.radians(jnp.array([0.0, 0.0, 30.0]))
    asked = tick_commands(40, 8, tuner.tick, time, omega)
    recorded = START + 2e-3 * jnp.sin(jnp.arange(40.0) / 5.0)
    _, ticks = roll(simulator, begin(), asked, recorded, tuner)
    asked = jax.tree.map(lambda values: values.reshape(160, 2), asked)
    recorded = jnp.full(160, jnp.nan).at[::4].set(recorded)
    _, found = roll(simulator, begin(), asked, recorded, fine)
    np.testing.assert_allclose(found.zeta, jnp.repeat(ticks.zeta, 4), rtol=0, atol=SAME)
    np.testing.assert_allclose(found.output.z[3::4], ticks.output.z, rtol=0, atol=SAME)


def test_zeta_changes_no_faster_than_one_step_a_tick(simulator):
    tuner = StepTuner(tick=0.01, zeta_step=2e-3)
    deep = jnp.full(60, START + 0.02)  # far deeper than any simulation gets in so short a time
    _, ticks = roll(simulator, begin(), commands(60, tuner), deep, tuner)
    expected = 0.78 - 2e-3 * np.arange(1, 61)
    np.testing.assert_allclose(ticks.zeta, expected, rtol=0, atol=60 * ROUNDING)
    rate = np.diff(ticks.zeta) / float(tuner.tick)
    np.testing.assert_allclose(rate, -2e-3 / 0.01, rtol=0, atol=RATE_ROUNDING)


def test_dead_band_holds_zeta(simulator):
    wide = StepTuner(tolerance=0.05)
    recorded = START + 5e-3 * jnp.cos(jnp.arange(60.0))
    _, ticks = roll(simulator, begin(), commands(60, wide), recorded, wide)
    np.testing.assert_array_equal(ticks.zeta, 0.78)
    still = StepTuner(zeta_step=0.0)
    _, ticks = roll(simulator, begin(), commands(60, still), recorded, still)
    np.testing.assert_array_equal(ticks.zeta, 0.78)


def test_tuner_follows_the_sinkage_that_another_zeta_gives(simulator):
    tuner = StepTuner(zeta_step=0.0)
    asked = commands(300, tuner, 60.0)
    _, soft = roll(simulator, begin(0.68), asked, jnp.full(300, jnp.nan), tuner)
    seen = jnp.concatenate([jnp.array([START]), soft.output.sinkage[:-1]])
    _, ticks = roll(simulator, begin(0.78), asked, seen, StepTuner())
    np.testing.assert_allclose(ticks.zeta[-50:].mean(), 0.68, rtol=0, atol=FOLLOWED)


# What is known at a tick -------------------------------------------------------------------------


def test_a_tick_knows_the_newest_sample_and_none_of_the_future():
    time, sinkage = np.array([0.02, 0.04, 0.06]), np.array([1.0, 2.0, 3.0])
    known = known_sinkage(np.array([0.0, 0.02, 0.03, 0.05999, 0.06]), time, sinkage)
    np.testing.assert_array_equal(known, [np.nan, 1, 1, 2, 3])


def test_a_tick_in_a_gap_or_past_the_end_knows_nothing_once_the_sample_is_old():
    time = np.array([0.0, 0.02, 0.04, 0.2, 0.22])
    known = known_sinkage(np.array([0.04, 0.06, 0.08, 0.19, 0.2, 0.245, 1.0]), time, 10 * time)
    np.testing.assert_allclose(known, [0.4, 0.4, np.nan, np.nan, 2.0, 2.2, np.nan])


def test_the_settings_decide_when_a_sample_is_old():
    time = np.array([0.0, 0.02, 0.04])
    known = known_sinkage(np.array([0.08, 0.12]), time, time, ReplaySettings(max_age=3.0))
    np.testing.assert_array_equal(known, [0.04, np.nan])
