"""A delay of the readings, whatever the step of the loop."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.state import Output, State
from tests.helpers.effect_runs import KNOWN, RIM, rows, simulator

# Where only rounding and the step itself lie between.
CLOSE = 1e-9


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
