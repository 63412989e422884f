"""The tuners beside eq. 7: their laws, their limits, and the derivative that the filter goes by."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.command import Command
from drftjax.physics.state import State
from drftjax.physics.wheel import GrouserWheel
from drftjax.simulation.simulator import Simulator
from drftjax.tuning.kalman_tuner import KalmanTuner
from drftjax.tuning.pi_tuner import ProportionalIntegralTuner
from drftjax.tuning.replay import replay_tuner
from drftjax.tuning.step_tuner import (
    Loop,
    tick_commands,
    tuned_tick,
    with_tuner_memory,
    with_zeta_per_step,
)

# The law by hand: a few roundings of numbers of order one.
SAME = 1e-14
# Central differences over 1e-6 of zeta, in which plates cross corners: 3e-5 of this derivative.
BY_DIFFERENCES = 1e-4
# The proportional-integral law leaves 20 um alone, worth 8e-4 of zeta at 25 mm of sinkage a zeta;
# the last readings [m] swing by half as much beyond.
FOUND, MET = 1e-3, 3e-5
# A wheel that rests creeps under its rest force: it forgets and gains [m] less than a hundredth of
# what a wheel that rolls does in a tick, 0.013 and 3.6e-4 m.
KEPT, GAINED = 1e-4, 1e-6
# Twenty readings that are 5e-4 m off tell a tenth of doubt, at 1e-7 m of gain and 1e-4 m of noise,
# 0.1^2 * 20 * 1e-7 * 5e-4 / 1e-4^2 at most; and their gap asks for (1 - exp(-0.02)) * 5e-4 * 1e-7 /
# (1e-3 * 0.01)^2 = 0.01 of zeta.
BELIEVED, ASKED = 1e-3, 0.011
SUBSTEPS = 5
# Of every replay, so that one program for each tuner makes them.
TICKS = 500
START = 0.0176
SPEED = 0.5
TUNERS = [ProportionalIntegralTuner(), KalmanTuner()]
NAMES = ["pi", "kalman"]
roll = eqx.filter_jit(replay_tuner)


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(GrouserWheel(plate_size=0.01))


def turning(ticks: int, tick: float = 0.01):
    time, omega = jnp.array([0.0, 0.2, 1.2]), jnp.array([0.0, 0.0, SPEED])
    return tick_commands(ticks, SUBSTEPS, tick, time, omega)


def begin(zeta: float = 0.78) -> Loop:
    return Loop(State.at_rest(START), jnp.asarray(zeta))


def tune(tuner, *errors: float, zeta: float = 0.78) -> list[float]:
    memory, zetas = tuner.begin(State.at_rest(START), jnp.asarray(zeta)), [zeta]
    for error in errors:
        new, memory = tuner.tune(memory, jnp.asarray(zetas[-1]), jnp.asarray(error))
        zetas.append(float(new))
    return zetas[1:]


# Both --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tuner", TUNERS, ids=NAMES)
def test_ticks_without_a_measurement_hold_zeta(simulator, tuner):
    recorded = jnp.full(TICKS, jnp.nan).at[10].set(START + 1e-3)
    _, ticks = roll(simulator, begin(), turning(TICKS), recorded, tuner)
    np.testing.assert_array_equal(ticks.zeta[:10], 0.78)
    assert ticks.zeta[10] != 0.78
    np.testing.assert_array_equal(ticks.zeta[10:], ticks.zeta[10])


@pytest.mark.parametrize("tuner", TUNERS, ids=NAMES)
@pytest.mark.parametrize(("deeper", "sign"), [(1e-3, -1), (-1e-3, +1)])
def test_zeta_moves_against_the_error(simulator, tuner, deeper, sign):
    _, free = roll(simulator, begin(), turning(TICKS), jnp.full(TICKS, jnp.nan), tuner)
    seen = jnp.concatenate([jnp.array([START]), free.output.sinkage[:-1]]) + deeper
    _, ticks = roll(simulator, begin(), turning(TICKS), seen, tuner)
    # A millimetre is worth 0.04 of zeta; the filter learns slowly while the wheel hardly turns.
    assert sign * (ticks.zeta[99] - 0.78) > 0.005


@pytest.mark.parametrize("tuner", TUNERS, ids=NAMES)
def test_zeta_finds_the_sand_that_another_zeta_is(simulator, tuner):
    asked = turning(TICKS)
    _, soft = roll(simulator, begin(0.68), asked, jnp.full(TICKS, jnp.nan), tuner)
    seen = jnp.concatenate([jnp.array([START]), soft.output.sinkage[:-1]])
    _, ticks = roll(simulator, begin(0.78), asked, seen, tuner)
    np.testing.assert_allclose(ticks.zeta[-100:].mean(), 0.68, rtol=0, atol=FOUND)
    assert float(jnp.abs(ticks.error[-100:]).max()) < MET


@pytest.mark.parametrize("tuner", TUNERS, ids=NAMES)
def test_zeta_stays_within_its_bounds_and_comes_back(simulator, tuner):
    bounded = eqx.tree_at(lambda t: (t.low, t.high), tuner, (jnp.asarray(0.75), jnp.asarray(0.8)))
    asked = turning(TICKS)
    absurd = jnp.where(jnp.arange(TICKS) < 100, START + 0.03, START - 0.01)
    _, ticks = roll(simulator, begin(), asked, absurd, bounded)
    assert float(ticks.zeta.min()) == 0.75
    # A hundred ticks at the bound have wound nothing up: the next ones lead away from it.
    assert float(ticks.zeta[130:].min()) > 0.75


# The proportional-integral law -------------------------------------------------------------------


def test_proportional_integral_law_by_hand():
    tuner = ProportionalIntegralTuner(proportional=40.0, integral=60.0, tolerance=0.0, rate=100.0)
    first = 0.78 - (40 * 1e-4 + 60 * 1e-4 * 0.01)
    second = first - (40 * 1e-4 + 60 * 2e-4 * 0.01)
    np.testing.assert_allclose(tune(tuner, 1e-4, 2e-4), [first, second], rtol=0, atol=SAME)


def test_wait_for_a_measurement_counts_as_a_longer_tick():
    tuner = ProportionalIntegralTuner(proportional=0.0, integral=60.0, tolerance=0.0, rate=100.0)
    nan = float("nan")
    np.testing.assert_allclose(
        tune(tuner, nan, nan, nan, 1e-4)[-1], 0.78 - 60 * 1e-4 * 0.04, rtol=0, atol=SAME
    )


def test_error_within_the_tolerance_is_left_alone():
    assert tune(ProportionalIntegralTuner(tolerance=1e-4), 0.9e-4, -0.9e-4) == [0.78, 0.78]


def test_rate_of_zeta_is_limited():
    tuner = ProportionalIntegralTuner(rate=0.5)
    np.testing.assert_allclose(tune(tuner, 0.05), 0.78 - 0.5 * 0.01, rtol=0, atol=SAME)


# The filter --------------------------------------------------------------------------------------


def test_filter_goes_by_the_derivative_of_the_simulation(simulator):
    """The sensitivity that it carries along, put together again, is dH/dzeta of the whole run."""
    tuner, ticks = KalmanTuner(), 60
    asked, ready = turning(ticks), with_zeta_per_step(simulator)

    @jax.jit
    def sinkage(zeta):
        loop = begin(0.0)
        loop = with_tuner_memory(tuner, Loop(loop.state, zeta))

        def tick(carried, commands):
            loop, whole = carried
            loop, _ = tuned_tick(ready, tuner, loop, commands, jnp.asarray(jnp.nan))
            whole = loop.memory.kept * whole + loop.memory.gained
            return (loop, whole), None

        (loop, whole), _ = jax.lax.scan(tick, (loop, jnp.zeros(())), asked)
        return -loop.state.position[1], whole

    def from_rest(zeta):
        return sinkage(jnp.asarray(zeta))[0]

    whole = float(sinkage(jnp.asarray(0.78))[1])
    step = 1e-6
    slope = float(from_rest(0.78 + step) - from_rest(0.78 - step)) / (2 * step)
    # Driving gives up 9 mm a zeta by then: there is something to compare.
    assert slope < -1e-3
    np.testing.assert_allclose(whole, slope, rtol=BY_DIFFERENCES)


def test_filter_learns_nothing_of_a_wheel_that_rests():
    tuner = KalmanTuner()
    ready = with_zeta_per_step(Simulator(GrouserWheel(plate_size=0.01)))
    still = Command(*(jnp.zeros(SUBSTEPS) for _ in range(3)))
    one = eqx.filter_jit(tuned_tick)
    # Far stronger sand than the load needs: the wheel does not sink at all.
    loop = with_tuner_memory(tuner, begin(3.0))
    for _ in range(20):
        loop, tick = one(ready, tuner, loop, still, jnp.asarray(START + 5e-4))
    memory = loop.memory
    assert float(memory.kept) == pytest.approx(1.0, abs=KEPT)
    assert float(memory.gained) == pytest.approx(0.0, abs=GAINED)
    assert float(memory.strength) == pytest.approx(3.0, abs=BELIEVED)
    assert float(tick.zeta) == pytest.approx(3.0, abs=ASKED)


def test_filter_in_which_nothing_is_noisy_but_the_readings_holds_zeta(simulator):
    tuner = KalmanTuner(drift=0.0, doubt=0.0, wander=0.0, reach=0.0)
    _, ticks = roll(simulator, begin(), turning(TICKS), jnp.full(TICKS, START + 1e-3), tuner)
    np.testing.assert_array_equal(ticks.zeta, 0.78)


@pytest.mark.parametrize(
    ("kind", "given", "said"),
    [
        (ProportionalIntegralTuner, {"proportional": -1.0}, "proportional gain is -1"),
        (ProportionalIntegralTuner, {"low": 2.0, "high": 1.0}, "lowest zeta is 2"),
        (KalmanTuner, {"noise": 0.0}, "noise of a reading is 0"),
        (KalmanTuner, {"recovery": float("nan")}, "recovery time is nan"),
        (KalmanTuner, {"tick": 0.0}, "tick is 0"),
    ],
)
def test_tuner_that_cannot_be_is_refused(kind, given, said):
    with pytest.raises(InputError, match=said):
        kind(**given)
