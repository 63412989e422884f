"""A delay of the readings or of one channel, whatever the step of the loop."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.common.errors import InputError
from drftjax.physics.state import Output, State
from tests.helpers.effect_runs import KNOWN, RIM, driven, rows, simulator

# Where only rounding and the step itself lie between.
CLOSE = 1e-9
FORCES = ("fx", "fz", "torque")


@cache
def standing() -> Output:
    """Output of a wheel at rest; the tests replace its x."""
    return rows(simulator(RIM), State.at_rest(0.02), np.zeros(1), 1e-3, 1)


def read_late(truth, dt: float, delay: float) -> np.ndarray:
    """Readings of an x that is truth(t), step by step."""
    effect = KNOWN["measurement_delay"](delay=delay)
    output = jax.tree.map(lambda channel: channel[0], standing())

    def read(memory, x):
        late, memory = effect.read(replace(output, x=x), jnp.asarray(dt), memory)
        return memory, late.x

    x = jnp.asarray(truth(dt * np.arange(round(2.5 / dt))))
    return np.asarray(jax.lax.scan(read, effect.begin(replace(output, x=x[0])), x[1:])[1])


@pytest.mark.parametrize("ms", [0.5, 1, 2, 3, 4, 5, 6, 7, 9, 10, 20])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.9, 1.0])
def test_a_ramp_is_read_late_by_the_delay_whatever_the_step(ms, delay):
    dt = ms / 1e3
    late = read_late(lambda time: time, dt, delay)
    time = dt * np.arange(1, len(late) + 1)
    np.testing.assert_allclose(
        late, np.maximum(time - delay, 0), rtol=0, atol=dt if delay else CLOSE
    )
    np.testing.assert_allclose(late[time > 1.1], time[time > 1.1] - delay, rtol=CLOSE)


@pytest.mark.parametrize("ms", [0.5, 1, 2, 5, 10])
@pytest.mark.parametrize("delay", [0.1, 0.123, 1.0])
def test_at_steps_that_divide_10_ms_a_delay_joins_the_truth_at_each_10_ms(ms, delay):
    dt = ms / 1e3
    late = read_late(np.sin, dt, delay)
    for row in range(0, len(late), 7):
        time = dt * (row + 1)
        kept = np.arange(0, time - dt / 2, 0.01)
        knots = np.append(kept, time)
        assert late[row] == pytest.approx(np.interp(time - delay, knots, np.sin(knots)), abs=CLOSE)


def test_each_channel_is_late_by_its_own_clock_and_no_other():
    """Against the rows of the run without delays, so many steps of 10 ms before."""
    dt, steps = 0.01, 200
    late = {"travel_delay": ("x",), "sinkage_delay": ("z",), "channel_delay": FORCES}
    count = {"travel_delay": 20, "sinkage_delay": 30, "channel_delay": 7}
    omega = 2.0 + np.sin(np.arange(1, steps + 1) / 9)
    delays = tuple(KNOWN[name](delay=dt * count[name]) for name in late)

    start = driven(True, 2.0)

    @jax.jit
    def both():
        sim = simulator(RIM)
        slow = replace(sim, effects=delays)
        return [rows(each, start, omega, dt, 1) for each in (sim, slow)]

    truth, read = both()
    for name, channels in late.items():
        for channel in channels:
            true, slow = (np.asarray(getattr(each, channel)) for each in (truth, read))
            expected = np.concatenate([np.full(count[name], true[0]), true[: -count[name]]])
            # The reading moves over that time, or lateness would not show.
            assert np.ptp(true) > 1e3 * CLOSE * np.abs(true).max()
            np.testing.assert_allclose(slow, expected, rtol=CLOSE, atol=CLOSE)
    np.testing.assert_allclose(read.sinkage, -np.asarray(read.z), rtol=CLOSE)
    for channel in ("vx", "vz", "angle", "omega"):
        np.testing.assert_allclose(getattr(read, channel), getattr(truth, channel), atol=CLOSE)


@pytest.mark.parametrize("name", ["travel_delay", "sinkage_delay", "channel_delay"])
def test_a_late_channel_asks_for_that_channel(name):
    shown = {"travel_delay": "x", "sinkage_delay": "z", "channel_delay": "torque"}[name]
    about = KNOWN[name].about
    about.require_shown((shown,))
    others = {"x", "z", *FORCES} - set(about.channels)
    with pytest.raises(InputError, match=f"{name} shows in"):
        about.require_shown(sorted(others))
