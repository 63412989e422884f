"""Gradients over the paper's whole 24 s: forward, reverse and central differences agree.

The program that steps the wheel is smooth but for corners: a plate that enters the sand, or begins
to lead, changes the matrix that a step solves with. So three questions are asked apart.
1. Are the derivatives those of the program? Central differences over steps so short that hardly a
   corner is passed say so, to `AGREEMENT`.
2. Do they tell how the run answers a change that someone would make? Differences over a part in a
   thousand say so, to `WIDE`.
3. Are they those of the equations, whatever the step? The same with the other integrator and a
   four times longer step says so, to `METHODS`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from drftjax.physics.integrator import DEFAULT_STEP
from drftjax.setups.setup import CommandSetUp, SetUp
from drftjax.simulation.rollout import simulate
from drftjax.simulation.statics import sinkage_under_load
from tests.studies.runs import profile

# Of the largest change: differences cross corners where plates turn over.
AGREEMENT = 1e-3
WIDE = 1e-2
METHODS = 2e-2
# Forward and reverse mode multiply the same matrices in another order.
ORDER = 1e-9

# Rows and their states take 8 MB [B]; 48,000 steps whole, some hundreds of numbers each, would take
# hundreds.
LARGEST_MEMORY = 30e6

NAMES = ("zeta", "lambda", "radius", "grouser height", "mass_z")
# Relative steps. lambda moves the mean sinkage by a nanometre in all, so that its steps must be
# long to stand over rounding, and may be, as it moves no plate over a corner.
SHORT = np.array([[1e-7, 3e-4, 1e-7, 1e-7, 1e-7], [3e-7, 1e-3, 3e-7, 3e-7, 3e-7]])
SHORT = np.concatenate([SHORT, [[1e-6, 3e-3, 1e-6, 1e-6, 1e-6]]])


def parameters(simulator):
    return (
        simulator.terrain.zeta.value,
        simulator.terrain.law.inertial_coefficient,
        simulator.wheel.radius,
        simulator.wheel.grouser_height,
        simulator.rig.mass_z,
    )


def outcome(run, step):
    """Mean z and final x of a run, as a function of factors on the five parameters."""
    start, commands = run.start(), run.commands(step)

    def of(factors):
        values = [factor * p for factor, p in zip(factors, parameters(run.simulator), strict=True)]
        simulator = eqx.tree_at(parameters, run.simulator, values)
        _, rows = simulate(simulator, start, commands, step, every=round(0.02 / step))
        return jnp.stack([jnp.mean(rows.z), rows.x[-1]])

    return of


AT = np.ones(len(NAMES))


@pytest.fixture(scope="module")
def default():
    return outcome(profile(), DEFAULT_STEP)


@pytest.fixture(scope="module")
def forward(default):
    return np.asarray(jax.jit(jax.jacfwd(default))(jnp.asarray(AT)))


@pytest.fixture(scope="module")
def reverse(default):
    return jax.jit(jax.jacrev(default)).lower(jnp.asarray(AT)).compile()


def differences(function, steps):
    """Central differences (outcomes, parameters) with one relative step a parameter."""
    ahead = AT + np.diag(steps)
    behind = AT - np.diag(steps)
    values = jax.jit(jax.vmap(function))(jnp.asarray(np.concatenate([ahead, behind])))
    ahead, behind = np.split(np.asarray(values), 2)
    return ((ahead - behind) / (2 * steps[:, None])).T


def test_forward_and_reverse_mode_agree(forward, reverse):
    np.testing.assert_allclose(reverse(jnp.asarray(AT)), forward, rtol=ORDER)


def test_central_differences_agree_over_short_steps(default, forward):
    # One of three steps may still straddle a corner: their median does not.
    error = [differences(default, steps) / forward - 1 for steps in SHORT]
    assert np.max(np.abs(np.median(error, axis=0))) < AGREEMENT, dict(
        zip(NAMES, np.transpose(error), strict=True)
    )


def test_gradients_tell_how_a_run_answers_a_change_of_a_thousandth(default, forward):
    wide = differences(default, np.full(len(NAMES), 1e-3))
    np.testing.assert_allclose(wide, forward, rtol=WIDE)


def test_gradients_are_the_same_at_half_the_step(forward):
    held = outcome(profile(), DEFAULT_STEP / 2)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(held))(jnp.asarray(AT)), forward, rtol=METHODS)


def test_gradients_have_the_signs_of_physics(forward):
    zeta, inertia, _, _, mass = forward[0]
    assert zeta > 0  # firmer sand carries the wheel higher,
    assert inertia > 0  # and so does sand that must be set in motion;
    assert mass < 0  # a heavier wheel sinks.
    assert forward[1, 2] > 1.0  # A larger wheel goes farther, about in proportion to its 1.17 m.


def test_reverse_mode_over_the_whole_run_needs_little_memory(reverse):
    assert reverse.memory_analysis().temp_size_in_bytes < LARGEST_MEMORY


@pytest.fixture(scope="module")
def falling():
    """z at the end of a fall from a height, and the height at which the wheel would stand."""
    setup = SetUp(command=CommandSetUp([0.0, 0.5], [0.0, 0.0]))
    setup.integrator.step = 5e-3
    trial = setup.trial(5e-3)

    @jax.jit
    def end(height):
        moved = eqx.tree_at(lambda t: t.start.position, trial, jnp.stack([0 * height, height]))
        return moved.run().z[-1]

    return end, -float(sinkage_under_load(trial.simulator, setup.terrain.zeta))


@pytest.mark.parametrize("above", [1e-4, 1.17e-3, 3e-3])
def test_a_wheel_that_falls_ends_the_deeper_the_higher_it_was_let_go(above, falling):
    end, standing = falling
    start, step = standing + above, 1e-7
    difference = (end(start + step) - end(start - step)) / (2 * step)
    assert difference < -0.8
    assert jax.jacfwd(end)(start) == pytest.approx(float(difference), rel=AGREEMENT)
